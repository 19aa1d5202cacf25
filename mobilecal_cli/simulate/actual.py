"""The physical robot and board behind a description: stated values plus displacements (see `imperfect`).

The formulas are written out here, independently of the estimator's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.model import Board, Camera, CameraRig, FloatArray
from mobilecal_cli.simulate.robot import Lens, RobotJoint, SimulatedRobot, Vector, pose
from mobilecal_cli.simulate.route import Route, base_in_world

DISTORTIONS = ("radial_1", "radial_2", "tangential_x", "tangential_y")
_MOVED_RAD = 1e-9
_DIRECTION_STEP_S = 0.02


def crosswise(axis: Vector | FloatArray) -> dict[str, FloatArray]:
    """The two coordinate axes least aligned with an axis, made orthonormal to it: letter → (3,) unit vector."""
    unit = np.array(axis) / np.linalg.norm(axis)
    axes: dict[str, FloatArray] = {}
    for k in sorted(np.argsort(np.abs(unit), kind="stable")[:2]):
        e = np.eye(3)[k]
        for other in (unit, *axes.values()):
            e = e - (e @ other) * other
        axes["xyz"[k]] = e / np.linalg.norm(e)
    return axes


def joint_key(robot: SimulatedRobot, joint: str) -> str:
    """Name of a joint in the names of its constants."""
    return {robot.pan: "pan", robot.tilt: "tilt"}.get(joint, joint)


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape:
    """A board as it is: its corners in its own frame, and its surface.

    Attributes:
        board: as stated.
        scale: (2,) true over stated size along x and y.
        bends_m: (3,) z of the surface is (1 - xi^2) and (1 - eta^2) and xi eta times these, m.
        shear_rad: angle by which columns and rows are off the right angle.
    """

    board: Board
    scale: FloatArray = field(default_factory=lambda: np.ones(2))
    bends_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    shear_rad: float = 0.0

    def height_m(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height z of the surface at positions on the print, in squares: arrays of equal shape → m."""
        grid, (bend_x, bend_y, twist) = self.board.grid()[:, :2], self.bends_m
        (middle_x, middle_y), (half_x, half_y) = (grid.max(0) + grid.min(0)) / 2, np.ptp(grid, axis=0) / 2
        xi, eta = (x - middle_x) / half_x, (y - middle_y) / half_y
        return np.asarray(bend_x * (1 - xi**2) + bend_y * (1 - eta**2) + twist * xi * eta)


@dataclass(frozen=True, slots=True, eq=False)
class ActualRobot:
    """The physical robot behind a description.

    Attributes:
        stated: the description; its `T_h_c` and `wheels` are true.
        constants: name → true minus stated value, see `imperfect`; a missing one is zero.
    """

    stated: SimulatedRobot
    constants: Mapping[str, float]

    def _of(self, name: str) -> float:
        return self.constants.get(name, 0.0)

    def _vector(self, prefix: str, axes: Mapping[str, FloatArray]) -> FloatArray:
        """Sum of the constants `<prefix>_<letter>` along their axes, (3,)."""
        parts = [self._of(f"{prefix}_{letter}") * axis for letter, axis in axes.items()]
        return np.asarray(np.sum(parts, axis=0), dtype=np.float64)

    @property
    def rig_cameras(self) -> CameraRig:
        """The cameras as they are."""
        rig = self.stated.rig_cameras
        poses = list(rig.T_c_each)
        if rig.calibrated:
            T_c_r = poses[1].copy()
            turn = self._vector("stereo_r", dict(zip("xyz", np.eye(3), strict=True)))
            T_c_r[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ T_c_r[:3, :3]
            swing = self._vector("baseline", crosswise(T_c_r[:3, 3]))
            T_c_r[:3, 3] = Rotation.from_rotvec(swing).apply(T_c_r[:3, 3]) * (1 + self._of("baseline_scale"))
            poses[1] = T_c_r
        for k, name in enumerate(rig.names[1:], 1):
            T = poses[k].copy()
            turn, shift = (
                np.array([self._of(f"{kind}_{name}_{letter}") for letter in "xyz"])
                for kind in ("turn", "shift")
            )
            T[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3]
            T[:3, 3] += shift
            poses[k] = T
        each = tuple(self._camera(camera, name) for camera, name in zip(rig.each, rig.names, strict=True))
        return replace(rig, each=each, T_c_each=tuple(poses))

    def _camera(self, stated: Camera, name: str) -> Camera:
        K = stated.K.copy()
        aspect = self._of(f"focal_aspect_{name}") / 2
        K[[0, 1], [0, 1]] *= 1 + self._of(f"focal_{name}") + np.array([aspect, -aspect])
        K[:2, 2] += stated.width * np.array([self._of(f"principal_{name}_{letter}") for letter in "xy"])
        shares = np.array([self._of(f"distortion_{name}_{term}") for term in DISTORTIONS])
        size = (stated.frame_id, stated.width, stated.height)
        if not np.any(shares):
            return Camera(*size, K, stated.D, stated.distortion)
        return Lens(*size, K, stated.D, stated.distortion, center_px=stated.K[:2, 2], shares=shares)

    def shape(self, board: Board) -> BoardShape:
        """A stated board as it is."""
        aspect = self._of("square_aspect") / 2
        scale = (1 + self._of("square_scale")) * np.array([1 + aspect, 1 - aspect])
        bends = [self._of("board_bend_x"), self._of("board_bend_y"), self._of("board_twist")]
        return BoardShape(board, scale, np.array(bends), self._of("board_shear"))

    @property
    def lean(self) -> FloatArray:
        """(4, 4) the base as it leans, in a frame along the floor's normal."""
        turn = [self._of("lean_roll"), self._of("lean_pitch"), 0.0]
        return pose((0.0, 0.0, 0.0), Rotation.from_rotvec(turn))

    @property
    def joints(self) -> tuple[RobotJoint, ...]:
        """The chain as it is, from base to head."""
        return tuple(self._joint(joint) if joint.name else joint for joint in self.stated.joints)

    def _joint(self, joint: RobotJoint) -> RobotJoint:
        key, axes = joint_key(self.stated, joint.name), crosswise(joint.axis)
        axis = Rotation.from_rotvec(self._vector(f"{key}_axis", axes)).apply(joint.axis)
        shift = Rotation.from_euler("xyz", joint.rpy_rad).apply(self._vector(f"{key}_position", axes))
        x, y, z = (float(value) for value in np.array(joint.xyz_m) + shift)
        return replace(joint, xyz_m=(x, y, z), axis=(float(axis[0]), float(axis[1]), float(axis[2])))

    def _of_each(self, name: str) -> FloatArray:
        """(J,) a constant of every joint."""
        return np.array(
            [self._of(name.format(joint_key(self.stated, joint))) for joint in self.stated.joint_names]
        )

    def positions(self, route: Route, times_s: FloatArray) -> FloatArray:
        """(n, J) what the encoders measure at given times, rad: the route's joint positions, within the backlash.

        position + approach_direction * backlash / 2; the clock of the joints stamps a measurement `time_joints`
        after it.
        """
        late_s = self._of("time_joints")
        times_s = np.clip(times_s - late_s, 0, route.duration_s) if late_s else times_s
        position, play = route.joints(times_s), self._of_each("backlash_{}")
        return position + approach_directions(route, times_s) * play / 2 if np.any(play) else position

    def readings(self, route: Route, times_s: FloatArray) -> FloatArray:
        """(n, J) noise-free joint readings at given times, rad: (position - zero) / (1 + scale)."""
        zero, scale = self._of_each("{}_zero"), self._of_each("{}_scale")
        return np.asarray((self.positions(route, times_s) - zero) / (1 + scale))


def camera_in_world(actual: ActualRobot, route: Route, times_s: FloatArray, floor: FloatArray) -> FloatArray:
    """T_w_c of the first camera at given times, (N, 4, 4); `floor` as from `imperfect.floor_in_base`."""
    robot = replace(actual.stated, joints=actual.joints)
    heads = np.array([robot.head_pose(joints) for joints in route.joints(times_s)])
    return np.asarray(base_in_world(route.drive.poses(times_s)) @ floor @ actual.lean @ heads @ robot.T_h_c)


def approach_directions(route: Route, times_s: FloatArray) -> FloatArray:
    """(n, J) direction of each joint's last motion before given times: +1, -1, or 0 before the first motion."""
    moments = np.unique(np.concatenate([np.arange(0, route.duration_s, _DIRECTION_STEP_S), times_s]))
    change = np.diff(route.joints(moments), axis=0, prepend=route.joints(moments[:1]))
    moving = np.abs(change) > _MOVED_RAD
    last = np.maximum.accumulate(np.where(moving, np.arange(len(moments))[:, None], 0), axis=0)
    directions = np.take_along_axis(np.sign(change) * moving, last, axis=0)
    return np.asarray(directions[np.searchsorted(moments, times_s)])
