"""Simulated robots with known parameters, and their stereo pairs.

Each robot is defined once, by its joints in order. The URDF and the simulator's own forward kinematics
are derived from that definition independently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import ClassVar, Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import SIDES, Camera, CameraInfo, CameraRig, Side, WheelGeometry

WIDTH, HEIGHT = 640, 480  # of the images, px
_WHEELBASE_M = 0.262  # between front and rear wheels of four
BASELINE_M = 0.12  # of the stereo pairs
JOINT_RATE_HZ = 50  # of the joint states, and of ticks and odometry
JOINT_NOISE_RAD = np.radians(0.01)  # sigma of one joint reading
TICKS_PER_REVOLUTION = 4096  # of a wheel's tick counter
TICK_BITS: Final = 16  # of its messages, so that it wraps
_INVERSE_ROUNDS = 25  # to rounding, with the distortion of these cameras


def stereo_infos(focal_px: float = 550.0, shift_px: float = 0.0) -> tuple[CameraInfo, CameraInfo]:
    """CameraInfo of the left and right camera: 640x480, 0.12 m baseline, moderate plumb_bob distortion.

    Args:
        focal_px: approximate focal length of both cameras, px.
        shift_px: offset of the principal points, so that two robots have different cameras, px.

    Returns:
        Left and right, with R and P as in ROS: P[0, 3] of the right camera is -f * baseline.
    """
    K_left = np.array([[focal_px, 0, 322.4 + shift_px], [0, focal_px + 0.8, 236.1 - shift_px], [0, 0, 1]])
    K_right = np.array(
        [[focal_px + 2.9, 0, 316.8 - shift_px], [0, focal_px + 3.3, 243.5 + shift_px], [0, 0, 1]]
    )
    D_left = np.array([-0.268, 0.087, 0.0006, -0.0004, 0.0])
    D_right = np.array([-0.274, 0.094, -0.0003, 0.0007, 0.0])
    R_c_r = Rotation.from_rotvec([0.0063, -0.0081, 0.0047])
    p_c_r = np.array([BASELINE_M, -0.0011, 0.0018])
    p_c_r *= BASELINE_M / np.linalg.norm(p_c_r)
    # Rectified axes: x along the baseline, z as near as possible to the mean of both optical axes.
    x = p_c_r / np.linalg.norm(p_c_r)
    forward = np.array([0.0, 0.0, 1.0]) + R_c_r.as_matrix()[:, 2]
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    R_rect_c = np.stack([x, y, np.cross(x, y)])
    P_left = np.array([[focal_px, 0, 320.0, 0], [0, focal_px, 240.0, 0], [0, 0, 1, 0]])
    P_right = P_left.copy()
    P_right[0, 3] = -focal_px * BASELINE_M
    left = CameraInfo("stereo_left_optical", WIDTH, HEIGHT, K_left, D_left, "plumb_bob", R_rect_c, P_left)
    R_rect_r = R_rect_c @ R_c_r.as_matrix()
    right = CameraInfo(
        "stereo_right_optical", WIDTH, HEIGHT, K_right, D_right, "plumb_bob", R_rect_r, P_right
    )
    return left, right


def distort(D: FloatArray, flat: FloatArray) -> FloatArray:
    """Apply plumb_bob distortion to z = 1 coordinates (..., 2); independent of the solver's code."""
    k1, k2, p1, p2, k3 = D
    x, y = flat[..., 0], flat[..., 1]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def pixels(camera: Camera, points: FloatArray) -> FloatArray:
    """Project points in the camera frame, (..., 3), to (..., 2) px; independent of the solver's code."""
    flat = points[..., :2] / points[..., 2:]
    if np.any(camera.D):
        flat = distort(camera.D, flat)
    return np.asarray(flat @ camera.K[:2, :2].T + camera.K[:2, 2])


def rays(camera: Camera, at: FloatArray) -> FloatArray:
    """Inverse of `pixels`: (..., 2) px → z = 1 coordinates (..., 2).

    Fixed-point iteration, which converges for moderate distortion.
    """
    flat = distorted = (at - camera.K[:2, 2]) / np.diagonal(camera.K)[:2]
    if np.any(camera.D):
        for _ in range(_INVERSE_ROUNDS):
            flat = flat + (distorted - distort(camera.D, flat))
    return flat


Vector = tuple[float, float, float]
#: Camera axes (right, down, forward) in a frame with x forward, y left, z up.
OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """One joint of the head chain, as in a URDF.

    Attributes:
        name: the joint's name, "" for a fixed one.
        link: name of its child link.
        xyz_m, rpy_rad: origin in the parent link (fixed-axis roll, pitch, yaw).
        axis: unit vector; unused for a fixed joint.
        limit_rad: joint limit in both directions, rad.
    """

    name: str
    link: str
    xyz_m: Vector
    rpy_rad: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    limit_rad: float = 2.5


def pose(xyz_m: FloatArray | Vector, rotation: Rotation) -> FloatArray:
    """(4, 4) transform of a rotation and the child's origin, m."""
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix()
    T[:3, 3] = xyz_m
    return T


@cache
def _origin(joint: RobotJoint) -> FloatArray:
    """(4, 4) a joint at zero, in its parent link."""
    return pose(joint.xyz_m, Rotation.from_euler("xyz", joint.rpy_rad))


#: From the true head-eye transform to the nominal one: a few degrees and centimeters.
_NOMINAL = pose((0.012, -0.008, 0.015), Rotation.from_euler("xyz", (1.5, -2.0, 1.0), degrees=True))


@dataclass(frozen=True, eq=False)
class SimulatedRobot:
    """A robot with known ground truth: `T_h_c` and `wheels` are the values that a calibration estimates.

    Attributes:
        name: of the robot.
        joints: from base to head.
        pan, tilt: names of the pan and the tilt joint, "" for none.
        infos: CameraInfo of the left and right camera, or of each that is `mounted`.
        T_h_c: (4, 4) true head-eye transform: first camera to head coordinates, m.
        wheels: true wheel radii and separation.
        nominal_wheels: nominal values, used in the URDF.
        encoder_step_rad: resolution of the wheel encoders, rad.
        wheel_signal: wheels as positions in the joint states, one or two for each side, as separate tick counters, or
            only as the odometry of a driver with the nominal wheels.
        slip: relative change of the effective separation with the turning rate, s/rad; `wheels` has that of a turn in
            place.
        mounted: other cameras than a stereo pair: name → pose in the first one, (4, 4) m.
    """

    name: str
    joints: tuple[RobotJoint, ...]
    infos: tuple[CameraInfo, ...]
    T_h_c: FloatArray
    wheels: WheelGeometry
    nominal_wheels: WheelGeometry
    pan: str = ""
    tilt: str = ""
    encoder_step_rad: float = 2 * np.pi / TICKS_PER_REVOLUTION
    wheel_signal: Literal["joint_states", "four_joints", "ticks", "odometry"] = "joint_states"
    slip: float = 0.0
    mounted: Mapping[str, FloatArray] = field(default_factory=dict)
    base_frame: ClassVar = "base_link"

    @property
    def T_h_c_nominal(self) -> FloatArray:
        """(4, 4) nominal head-eye transform, used in the URDF."""
        return np.asarray(self.T_h_c @ _NOMINAL)

    @property
    def head_frame(self) -> str:
        """Name of the head frame: the base's, where no joint moves the camera."""
        return self.joints[-1].link if self.joints else self.base_frame

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, from the base."""
        return tuple(joint.name for joint in self.joints if joint.name)

    @cached_property
    def rig_cameras(self) -> CameraRig:
        """The cameras, for raw images: by their poses, or a stereo pair.

        Of a pair: x_c = R_rect_c^T (R_rect_r x_r + (baseline, 0, 0)).
        """
        cameras = tuple(
            Camera(info.frame_id, info.width, info.height, info.K, info.D, info.distortion)
            for info in self.infos
        )
        rotations = np.stack([info.R for info in self.infos])
        if self.mounted:
            names = tuple(self.mounted)
            return CameraRig(names, cameras, np.stack([*self.mounted.values()]), False, rotations, names[0])
        left, right = self.infos
        baseline = np.array([-right.P[0, 3] / right.P[0, 0], 0, 0])
        poses = np.stack([np.eye(4), np.eye(4)])
        poses[1, :3, :3], poses[1, :3, 3] = left.R.T @ right.R, left.R.T @ baseline
        return CameraRig(SIDES, cameras, poses, False, rotations, "left", calibrated=True)

    def head_pose(self, joints_rad: FloatArray) -> FloatArray:
        """T_v_h from the simulator's own forward kinematics: (J,) → (4, 4)."""
        T_v_h = np.eye(4)
        angles = iter(joints_rad)
        for joint in self.joints:
            T_v_h = T_v_h @ _origin(joint)
            if joint.name:
                T_v_h = T_v_h @ pose((0, 0, 0), Rotation.from_rotvec(next(angles) * np.array(joint.axis)))
        return T_v_h

    def camera_namespace(self, camera: str) -> str:
        """Beginning of the topics of a camera."""
        if camera in SIDES:
            return f"/stereo/{camera}"
        return "/camera/color" if camera == "camera" else f"/{camera}"

    @property
    def wheel_joints(self) -> dict[Side, tuple[str, ...]]:
        """Names of the wheels' joints."""
        if self.wheel_signal == "four_joints":
            return {side: (f"front_{side}_wheel_joint", f"rear_{side}_wheel_joint") for side in SIDES}
        return {side: (f"wheel_{side}_joint",) for side in SIDES}


# Angles (ax, ay, az) with R = Rz(az) Ry(ay) Rx(ax). The lower-case sequence in scipy rotates about fixed axes: first x,
# then y, then z.
_PAPER_ROTATION = Rotation.from_euler("xyz", (-164.22, 89.38, -166.40), degrees=True)
#: Robot of the paper's Table 1 (optimized column): pitch and roll joints below a pan-tilt head.
PAPER_ROBOT = SimulatedRobot(
    name="paper",
    joints=(
        RobotJoint("torso_pitch_joint", "torso_pitch_link", (0.04, 0.0, 0.35), axis=(0, 1, 0), limit_rad=0.5),
        RobotJoint("torso_roll_joint", "torso_roll_link", (0.0, 0.0, 0.10), axis=(1, 0, 0), limit_rad=0.5),
        RobotJoint("head_pan_joint", "head_pan_link", (0.03, 0.0, 0.42), axis=(0, 0, 1), limit_rad=1.9),
        RobotJoint("head_tilt_joint", "head_tilt_link", (0.02, 0.0, 0.06), axis=(0, 1, 0), limit_rad=1.0),
        # Denavit-Hartenberg frame: x forward, y down, z left.
        RobotJoint("", "head_link", (0.05, 0.0, 0.03), (-np.pi / 2, 0.0, 0.0)),
    ),
    pan="head_pan_joint",
    tilt="head_tilt_joint",
    infos=stereo_infos(),
    T_h_c=pose(np.array((13.60, -64.34, -70.77)) / 1000, _PAPER_ROTATION),
    wheels=WheelGeometry(radius_right_m=0.22330, radius_left_m=0.22767, separation_m=0.50870),
    nominal_wheels=WheelGeometry(radius_right_m=0.225, radius_left_m=0.225, separation_m=0.500),
    encoder_step_rad=np.radians(1.2),
)


#: Small robot with a pan-tilt head and 16-bit tick counters with 4096 ticks per revolution.
TICK_ROBOT = SimulatedRobot(
    name="tick",
    joints=(
        RobotJoint("pan_joint", "pan_link", (0.08, 0.0, 0.62), axis=(0, 0, 1), limit_rad=2.2),
        RobotJoint("tilt_joint", "tilt_link", (0.0, 0.0, 0.05), axis=(0, 1, 0), limit_rad=1.0),
        RobotJoint("", "head_link", (0.03, 0.0, 0.02)),
    ),
    pan="pan_joint",
    tilt="tilt_joint",
    infos=stereo_infos(focal_px=520.0, shift_px=6.0),
    T_h_c=pose((0.045, 0.0615, 0.032), Rotation.from_euler("xyz", (1.2, -2.1, 1.7), degrees=True) * OPTICAL),
    wheels=WheelGeometry(radius_right_m=0.0824, radius_left_m=0.0817, separation_m=0.3372),
    nominal_wheels=WheelGeometry(radius_right_m=0.082, radius_left_m=0.082, separation_m=0.340),
    wheel_signal="ticks",
)


#: Robot with a stereo pair fixed to its base.
FIXED_CAMERA_ROBOT = SimulatedRobot(
    name="fixed_camera",
    joints=(),
    infos=stereo_infos(),
    T_h_c=pose((0.183, 0.0585, 0.524), Rotation.from_euler("xyz", (0.8, -1.6, 1.3), degrees=True) * OPTICAL),
    wheels=WheelGeometry(radius_right_m=0.0979, radius_left_m=0.0986, separation_m=0.3931),
    nominal_wheels=WheelGeometry(radius_right_m=0.098, radius_left_m=0.098, separation_m=0.390),
)


#: Skid-steered robot with four wheel joints: the effective separation is larger than the geometric one.
SKID_STEER_ROBOT = replace(
    TICK_ROBOT,
    name="skid_steer",
    wheels=WheelGeometry(radius_right_m=0.0986, radius_left_m=0.0979, separation_m=0.5612),
    nominal_wheels=WheelGeometry(radius_right_m=0.098, radius_left_m=0.098, separation_m=0.376),
    wheel_signal="four_joints",
    slip=0.02,
)


#: Robot with a pan-tilt head whose recording has the odometry of its driver, and neither wheels nor counters.
ODOMETRY_ROBOT = replace(
    TICK_ROBOT,
    name="odometry_only",
    wheels=WheelGeometry(radius_right_m=0.0344, radius_left_m=0.0347, separation_m=0.2361),
    nominal_wheels=WheelGeometry(radius_right_m=0.0352, radius_left_m=0.0352, separation_m=0.2300),
    wheel_signal="odometry",
)


_COLOR = replace(stereo_infos(focal_px=605.0)[0], frame_id="camera_color_optical_frame")
#: Small robot with the color camera of an RGB-D camera on its base.
RGBD_ROBOT = SimulatedRobot(
    name="rgbd",
    joints=(),
    infos=(replace(_COLOR, R=np.eye(3), D=np.array([0.12, -0.24, 0.0005, -0.0003, 0.1])),),
    T_h_c=pose((0.121, 0.0163, 0.267), Rotation.from_euler("xyz", (-0.9, -3.2, 1.1), degrees=True) * OPTICAL),
    wheels=WheelGeometry(radius_right_m=0.0352, radius_left_m=0.0349, separation_m=0.2297),
    nominal_wheels=WheelGeometry(radius_right_m=0.035, radius_left_m=0.035, separation_m=0.230),
    mounted={"camera": np.eye(4)},
)


#: Name, as in `targets.ROBOTS` → the robot.
ROBOTS = {
    robot.name: robot
    for robot in (
        PAPER_ROBOT,
        TICK_ROBOT,
        FIXED_CAMERA_ROBOT,
        RGBD_ROBOT,
        SKID_STEER_ROBOT,
        ODOMETRY_ROBOT,
    )
}


def urdf_text(robot: SimulatedRobot) -> str:
    """URDF with the head's joints and the nominal wheels; without a tilt joint, with the nominal camera."""
    T = robot.T_h_c_nominal
    # No motion of a robot without tilt shows the height of the camera: the description states it.
    rpy_rad = [] if robot.tilt else Rotation.from_matrix(T[:3, :3]).as_euler("xyz").tolist()
    values = {"camera_xyz_m": T[:3, 3].tolist(), "camera_rpy_rad": rpy_rad, "wheelbase_m": _WHEELBASE_M}
    return rendered("robot.urdf", robot=robot, **values)
