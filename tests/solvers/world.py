"""A small world by hand, independent of the product's kinematics and simulator: rotations by scipy, the base's path by the
instantaneous centre of rotation, the head's pose by writing it out."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.kinematics import Increments
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model import Parameters, WheelGeometry

WHEELS = WheelGeometry(radius_right_m=0.22330, radius_left_m=0.22767, separation_m=0.50870)
_EULER_DEG = (-166.40, 89.38, -164.22)  # the paper's Table 1, optimised: z, y, x
_T_X_M = (0.01360, -0.06434, -0.07077)


def matrix(rotation, translation=(0, 0, 0)):
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix() if isinstance(rotation, Rotation) else rotation
    T[:3, 3] = translation
    return T


X = matrix(Rotation.from_euler("ZYX", _EULER_DEG, degrees=True), _T_X_M)
TRUTH = Parameters(X, WHEELS)
_MOUNT = matrix(Rotation.identity(), (0.05, 0.0, 0.90))
_TILT_MOUNT = matrix(Rotation.identity(), (0.02, 0.0, 0.06))
_DENAVIT = matrix(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # x forward, y down, z left
BOARD_CENTRE = np.array([2.2, 0.3, 1.1])


def head(pan, tilt):
    turns = matrix(Rotation.from_euler("z", pan)), matrix(Rotation.from_euler("y", tilt))
    return _MOUNT @ turns[0] @ _TILT_MOUNT @ turns[1] @ _DENAVIT


class Base:
    """Drives on arcs about the instantaneous centre and writes down what the wheels turn."""

    def __init__(self):
        self.x = self.y = self.theta = 0.0
        self.right, self.left, self.leg = [], [], []

    def drive(self, leg, length_m, turn_rad, steps=20):
        for _ in range(steps):
            ds, dth = length_m / steps, turn_rad / steps
            if abs(dth) < 1e-12:
                self.x += ds * math.cos(self.theta)
                self.y += ds * math.sin(self.theta)
            else:
                radius = ds / dth
                centre = self.x - radius * math.sin(self.theta), self.y + radius * math.cos(self.theta)
                self.theta += dth
                self.x = centre[0] + radius * math.sin(self.theta)
                self.y = centre[1] - radius * math.cos(self.theta)
            self.right.append((ds + dth * WHEELS.separation_m / 2) / WHEELS.radius_right_m)
            self.left.append((ds - dth * WHEELS.separation_m / 2) / WHEELS.radius_left_m)
            self.leg.append(leg)

    @property
    def pose(self):
        return matrix(Rotation.from_euler("z", self.theta), (self.x, self.y, 0.0))


def make_pairs(seed=0, stations=12, long_way_round=False, moves=True, pixel_px=0.0):
    """Pairs of a drive in front of the board. pixel_px: noise of an ideal stereo pair (550 px, 0.12 m)."""
    random = np.random.default_rng(seed)
    base, T_w_v, T_v_h = Base(), [], []
    for station in range(stations):
        if station and moves:
            leg = station - 1
            base.drive(leg, random.uniform(-0.2, 0.2), random.uniform(-0.6, 0.6))
            base.drive(leg, float(np.clip(random.uniform(-0.3, 0.3) - base.x, -0.4, 0.4)), 0.0)
            back = random.uniform(-0.5, 0.5) - base.theta
            if long_way_round and station % 2:
                back -= math.copysign(2 * math.pi, back)
            base.drive(leg, 0.0, back, steps=60)
        T_w_v.append(base.pose)
        aim = BOARD_CENTRE + random.uniform(-0.25, 0.25, 3)
        seen_v = (np.linalg.inv(base.pose) @ [*aim, 1.0])[:3] - [0.05, 0.0, 0.90]
        pan, tilt = math.atan2(seen_v[1], seen_v[0]), -math.atan2(seen_v[2] - 0.06, math.hypot(*seen_v[:2]))
        T_v_h.append(head(pan, tilt))
    T_w_v, T_v_h = np.array(T_w_v), np.array(T_v_h)
    T_w_k = matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), BOARD_CENTRE)
    T_c_k = np.linalg.inv(T_w_v @ T_v_h @ X) @ T_w_k
    row, column = np.divmod(np.arange(54), 9)
    points_k = np.stack([0.08 * (column - 4), 0.08 * (row - 2.5), np.zeros(54), np.ones(54)], axis=1)
    points_c = np.einsum("nab,mb->nma", T_c_k, points_k)[..., :3]
    if pixel_px:
        f, baseline = 550.0, 0.12
        z = points_c[..., 2]
        noise = random.normal(scale=pixel_px, size=(3, *z.shape))
        u, v = (f * points_c[..., k] / z + noise[k] for k in (0, 1))
        depth = f * baseline / (f * baseline / z + noise[2] * math.sqrt(2))
        points_c = np.stack([u * depth / f, v * depth / f, depth], axis=-1)
    legs = np.stack([np.arange(stations - 1), np.arange(1, stations)], axis=1)
    turned = np.array([base.right, base.left])
    steps = Increments(*turned, np.array(base.leg, dtype=np.int64), stations - 1)
    return MotionPairs(T_v_h, T_c_k, points_c, legs, np.zeros(stations - 1, dtype=np.int64), steps)


def relative_errors(parameters):
    """Nine errors: rotation (rad), translation against |t_X|, wheels against themselves."""
    turn = Rotation.from_matrix(X[:3, :3].T @ parameters.T_h_c[:3, :3]).as_rotvec()
    move = (parameters.T_h_c[:3, 3] - X[:3, 3]) / np.linalg.norm(X[:3, 3])
    return np.concatenate([turn, move, parameters.wheels.vector / WHEELS.vector - 1])
