"""Robots and boards that are not as their description says: constants drawn from priors, and noise of floor and stamps.

`ImperfectWorld` renders them.

A constant is the true minus the stated value; the description, the head-eye transform and the wheels of the
`SimulatedRobot` remain as they are. The formulas are written out here, independently of the estimator's.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.export.text import decimal
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.rig import Board, Camera, CameraRig
from mobilecal_cli.simulate import robot as described
from mobilecal_cli.simulate.render import BoardRenderer, pixel_grid
from mobilecal_cli.simulate.robot import JOINT_RATE_HZ, RobotJoint, SimulatedRobot, Vector, pose
from mobilecal_cli.simulate.route import Route, base_in_world
from mobilecal_cli.simulate.scenario import BLUR_PX, WHEEL_NOISE_RAD_PER_SQRT_RAD, World

DISTORTIONS = ("radial_1", "radial_2", "tangential_x", "tangential_y")
_MOVED_RAD = 1e-9
#: Displaced by 0.4 % of the width: to 1e-8 px, because each round shrinks the error 50 times.
_DISPLACEMENT_ROUNDS = 5
_BEND_ROUNDS = 2  # a bend of a few mm moves the point on a ray by a hundredth of itself
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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lens(Camera):
    """A camera whose pixels are displaced from those of its model.

    Attributes:
        center_px: (2,) origin of the displacement.
        shares: (4,) displacement at the image corner by the radial terms of third and fifth order and by the
            tangential terms along x and y, in shares of the image width.
    """

    center_px: FloatArray
    shares: FloatArray

    def displacement(self, at: FloatArray) -> FloatArray:
        """Displacement of pixels, (..., 2) px → (..., 2) px."""
        half_px = np.hypot(self.width, self.height) / 2
        x, y = np.ascontiguousarray(np.moveaxis((at - self.center_px) / half_px, -1, 0))
        corner_x, corner_y = np.array([self.width, self.height]) / (2 * half_px)
        radial_1, radial_2, *tangential = self.shares
        n_x = np.hypot(3 * corner_x**2 + corner_y**2, 2 * corner_x * corner_y)
        n_y = np.hypot(2 * corner_x * corner_y, corner_x**2 + 3 * corner_y**2)
        along_x, along_y = tangential[0] / n_x, tangential[1] / n_y
        r2 = x**2 + y**2
        # The tangential terms are r^2 e + 2 (e p) p, with e the axis.
        common = r2 * (radial_1 + radial_2 * r2) + 2 * (along_x * x + along_y * y)
        return self.width * np.stack([common * x + along_x * r2, common * y + along_y * r2], axis=-1)


def pixels(camera: Camera, points: FloatArray) -> FloatArray:
    """`simulate.robot.pixels`, also of a `Lens`."""
    at = described.pixels(camera, points)
    return at + camera.displacement(at) if isinstance(camera, Lens) else at


def rays(camera: Camera, at: FloatArray) -> FloatArray:
    """Inverse of `pixels`: (..., 2) px → z = 1 coordinates (..., 2)."""
    if isinstance(camera, Lens):
        target = at
        for _ in range(_DISPLACEMENT_ROUNDS):
            at = target - camera.displacement(at)
    return described.rays(camera, at)


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
        constants: name → true minus stated value; a missing one is zero.
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
                [self._of(f"{kind}_{name}_{letter}") for letter in "xyz"] for kind in ("turn", "shift")
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
        keys = (joint_key(self.stated, joint) for joint in self.stated.joint_names)
        return np.array([self._of(name.format(key)) for key in keys])

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
    """T_w_c of the first camera at given times, (N, 4, 4); `floor` as from `floor_in_base`."""
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


#: Kind of constant → standard deviation of its prior: rad, m, s, or a share.
PRIORS: dict[str, float] = {
    "focal_length": 0.002,
    "principal_point": 0.003,
    "distortion": 0.0008,
    "stereo_rotation": np.radians(0.05),
    "baseline_direction": np.radians(0.1),
    "baseline_length": 0.002,
    "camera_rotation": np.radians(1.0),
    "camera_position": 0.005,
    "square_size": 0.001,
    "square_aspect": 0.001,
    "board_bend": 0.0005,
    "joint_zero": np.radians(0.5),
    "joint_scale": 0.001,
    "joint_axis": np.radians(0.1),
    "joint_position": 0.001,
    "backlash": np.radians(0.1),
    "clock": 0.2,
    "focal_aspect": 0.001,
    "board_shear": np.radians(0.05),
    "lean": np.radians(0.05),
    "stereo_clock": 0.002,
    "readout": 0.0005,
}
#: Kinds that a rendered recording does not have: every image is of one moment.
NOT_RENDERED = {"stereo_clock", "readout"}
#: Kinds that only moving recordings show.
_OF_MOTION = {"clock", *NOT_RENDERED}


@dataclass(frozen=True, slots=True)
class Noise:
    """Measurement noise; zero by default.

    Attributes:
        pixel_px: sigma of each corner coordinate, px.
        wheel_rad_per_sqrt_rad: sigma of a wheel's rotation over one radian; grows with the square root.
        encoder_step_rad: resolution of the wheel encoders, rad; 0 for unlimited.
        joint_rad: sigma of a station's joint reading, rad.
        floor_rad, floor_m: sigma of the base's roll and pitch, and of its height, at each station.
        sway_rad, sway_m: the same beside the floor's, another at each station whatever `floor_length_m`.
        stamp_s: sigma of each image stamp in motion, s.
        pair_s: the same of the time between the images of two cameras, s; extractions alone have it.
        shift_px: sigma of each image as a whole, along each axis, px; extractions alone have it.
        wheel_share: sigma of each wheel's relative scale error.
        floor_length_m: driven distance over which the floor stays alike; 0: another floor at each station.
        floor_smooth: the floor has slopes without steps (a Gaussian kernel), instead of an exponential one.
        floor_place_m: the floor is a smooth function of the place, whose heights are alike within this distance; 0: it
            is another one at each visit.
        wheel_length_m: driven distance over which a scale error stays the same; 0: one for each leg.
    """

    pixel_px: float = 0.0
    wheel_rad_per_sqrt_rad: float = 0.0
    encoder_step_rad: float = 0.0
    joint_rad: float = 0.0
    floor_rad: float = 0.0
    floor_m: float = 0.0
    sway_rad: float = 0.0
    sway_m: float = 0.0
    stamp_s: float = 0.0
    pair_s: float = 0.0
    shift_px: float = 0.0
    wheel_share: float = 0.0
    floor_length_m: float = 0.0
    floor_smooth: bool = False
    floor_place_m: float = 0.0
    wheel_length_m: float = 0.0


#: First guesses of the noise at each station or leg; the other levels depend on the robot.
STATION_NOISE = Noise(floor_rad=np.radians(0.1), floor_m=0.0005, stamp_s=0.0005, wheel_share=0.001)


def constant_kinds(robot: SimulatedRobot) -> dict[str, str]:
    """All constants of a robot and its board: name → kind."""
    kinds: dict[str, str] = {}
    rig = robot.rig_cameras
    for side in rig.names:
        kinds[f"focal_{side}"] = "focal_length"
        kinds |= dict.fromkeys((f"principal_{side}_{letter}" for letter in "xy"), "principal_point")
        kinds |= dict.fromkeys((f"distortion_{side}_{term}" for term in DISTORTIONS), "distortion")
    if rig.calibrated:
        kinds |= dict.fromkeys((f"stereo_r_{letter}" for letter in "xyz"), "stereo_rotation")
        baseline = crosswise(rig.T_c_each[1][:3, 3])
        kinds |= dict.fromkeys((f"baseline_{letter}" for letter in baseline), "baseline_direction")
        kinds |= {"baseline_scale": "baseline_length"}
    for name in () if rig.calibrated else rig.names[1:]:
        kinds |= {f"turn_{name}_{letter}": "camera_rotation" for letter in "xyz"}
        kinds |= {f"shift_{name}_{letter}": "camera_position" for letter in "xyz"}
    kinds |= {"square_scale": "square_size", "square_aspect": "square_aspect"}
    kinds |= {"board_bend_x": "board_bend", "board_bend_y": "board_bend"}
    moving = [joint for joint in robot.joints if joint.name]
    for joint in moving:
        key, letters = joint_key(robot, joint.name), crosswise(joint.axis)
        if joint is not moving[-1]:  # the head-eye transform absorbs the last one
            kinds[f"{key}_zero"] = "joint_zero"
        kinds[f"{key}_scale"] = "joint_scale"
        kinds |= dict.fromkeys((f"{key}_axis_{letter}" for letter in letters), "joint_axis")
        kinds |= dict.fromkeys((f"{key}_position_{letter}" for letter in letters), "joint_position")
        kinds[f"backlash_{key}"] = "backlash"
    kinds |= {"time_joints": "clock", "time_wheels": "clock"}
    kinds |= {f"focal_aspect_{side}": "focal_aspect" for side in rig.names}
    kinds |= {"board_twist": "board_bend", "board_shear": "board_shear"}
    kinds |= {"lean_roll": "lean", "lean_pitch": "lean"}
    return kinds | {f"time_{name}": "stereo_clock" for name in rig.names[1:]} | {"readout": "readout"}


def draw(
    robot: SimulatedRobot,
    random: np.random.Generator,
    scale: float = 1.0,
    kinds: Collection[str] | None = None,
) -> dict[str, float]:
    """Constants from their priors: name → value. Each kind gets the same values whichever others are drawn.

    Args:
        scale: of the priors' standard deviations.
        kinds: keys of `PRIORS` or names of constants; by default all but those that only moving recordings show.
    """
    of = constant_kinds(robot)
    chosen = set(PRIORS) - _OF_MOTION if kinds is None else set(kinds)
    if unknown := chosen - set(PRIORS) - set(of):
        raise ValueError(f"unknown kinds or constants: {', '.join(sorted(unknown))}")
    units = dict(zip(of, random.normal(size=len(of)), strict=True))
    drawn = {name: kind for name, kind in of.items() if {name, kind} & chosen}
    return {name: float(scale * PRIORS[kind] * units[name]) for name, kind in drawn.items()}


def station_times_s(route: Route, stations: int = 40) -> FloatArray:
    """Middle of every rest; on a route without rests, equally spaced times."""
    if len(route.rests_s):
        return np.asarray(route.rests_s.mean(axis=1))
    return np.linspace(0.5, route.duration_s - 0.5, stations)


def floor_in_base(noise: Noise, count: int, random: np.random.Generator, still: bool = False) -> FloatArray:
    """Roll, pitch and height of the base on an uneven floor, at each of some stations: (N, 4, 4), base axes."""
    turns, lifts = random.normal(size=(count, 2)), random.normal(size=count)
    return floor_poses(noise.floor_rad, noise.floor_m, turns, lifts, still)


def floor_poses(
    floor_rad: float, floor_m: float, turns: FloatArray, lifts: FloatArray, still: bool
) -> FloatArray:
    """Poses (N, 4, 4) of the base from unit random numbers; the same at all stations of a base that stands still.

    Args:
        floor_rad, floor_m: standard deviations of roll and pitch, and of height.
        turns, lifts: (N, 2) and (N,).
        still: whether the base never moves.
    """
    rotations = (Rotation.from_rotvec([roll, pitch, 0.0]) for roll, pitch in floor_rad * turns)
    heights = (floor_m * lifts).tolist()
    poses = np.array([pose((0.0, 0.0, z), turn) for z, turn in zip(heights, rotations, strict=True)])
    return np.repeat(poses[:1], len(poses), axis=0) if still else poses


def rolled_as_read(
    angles: FloatArray, leg: IntArray, noise: Noise, random: np.random.Generator
) -> FloatArray:
    """Wheel rotations with noise, before the encoders' steps.

    Args:
        angles: (n, 2) true rotations of the right and left wheel, rad.
        leg: (n - 1,) leg of each change, from 0.
    """
    change = np.diff(angles, axis=0)
    error = np.zeros(change.shape)
    if noise.wheel_rad_per_sqrt_rad:
        error += random.normal(size=change.shape) * noise.wheel_rad_per_sqrt_rad * np.sqrt(np.abs(change))
    if noise.wheel_share:
        error += noise.wheel_share * random.normal(size=(int(leg.max()) + 1, 2))[leg] * change
    return np.asarray(angles + np.concatenate([np.zeros((1, 2)), np.cumsum(error, axis=0)]))


class ImperfectRenderer(BoardRenderer):
    """Renders a board as it is, in one camera's images."""

    def __init__(
        self, camera: Camera, shape: BoardShape, blur_px: float, random: np.random.Generator
    ) -> None:
        self._shape = shape
        super().__init__(camera, shape.board, blur_px, random)

    def pixel_rays(self) -> FloatArray:
        return rays(self.camera, pixel_grid(self.camera))

    @property
    def _squares_m(self) -> FloatArray:
        return (self.board.square_m or 1.0) * self._shape.scale

    @property
    def _skew(self) -> float:
        """How many squares a column leans along x for each square along y."""
        scale = self._shape.scale
        return float(np.tan(self._shape.shear_rad) * scale[1] / scale[0])

    def pixels_of(self, T_x_k: FloatArray, at: FloatArray) -> FloatArray:
        heights = self._shape.height_m(*at.T)
        x, y = at[:, 0] + self._skew * at[:, 1], at[:, 1]
        points_k = np.column_stack([np.column_stack([x, y]) * self._squares_m, heights])
        return pixels(self.camera, points_k @ T_x_k[:3, :3].T + T_x_k[:3, 3])

    def on_board(self, T_x_k: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal, origin = T_x_k[:3, 2], T_x_k[:3, 3]
        along = rays @ normal[:2] + normal[2]
        columns = np.moveaxis(T_x_k[:3, :2] / self._squares_m, 1, 0)
        slopes = [rays @ column[:2] + column[2] for column in columns]
        depth = (normal @ origin) / along
        for bend in range(_BEND_ROUNDS + 1):
            x, y = (depth * slope - origin @ column for slope, column in zip(slopes, columns, strict=True))
            x -= self._skew * y
            if bend == _BEND_ROUNDS or not np.any(self._shape.bends_m):
                break
            depth = (normal @ origin + self._shape.height_m(x, y)) / along
        return x, y


@dataclass(frozen=True, eq=False)
class ImperfectWorld(World):
    """A robot and a board with constants drawn from their priors, and noise of the floor, the stamps and the wheels.

    An exact recording has the constants alone.
    """

    @cached_property
    def actual(self) -> ActualRobot:
        """The robot as it is."""
        kinds = {*PRIORS} - NOT_RENDERED if self.scenario.motion == "moving" else None
        random = np.random.default_rng([self.scenario.seed, 5])
        return ActualRobot(self.robot, draw(self.robot, random, kinds=kinds))

    @property
    def noise(self) -> Noise:
        """Additional noise."""
        return Noise() if self.scenario.exact else STATION_NOISE

    @property
    def cameras(self) -> CameraRig:
        return self.actual.rig_cameras

    def renderers(self, random: np.random.Generator) -> list[BoardRenderer]:
        shape = self.actual.shape(self.route.board)
        return [ImperfectRenderer(camera, shape, BLUR_PX, random) for camera in self.cameras.each]

    def _random(self) -> np.random.Generator:
        return np.random.default_rng([self.scenario.seed, 6])

    def camera_poses(self, times_s: FloatArray) -> FloatArray:
        rests_s = self.route.rests_s
        if not len(rests_s):
            floor = floor_in_base(self.noise, len(times_s), self._random())
        else:
            still = self.route.motion == "base_fixed"
            floor = floor_in_base(self.noise, len(rests_s), self._random(), still)
            floor = floor[np.searchsorted(rests_s[:, 0], times_s) - 1]
        return camera_in_world(self.actual, self.route, times_s, floor)

    def stamps_s(self, times_s: FloatArray) -> FloatArray:
        stamps_s = times_s + self.scenario.camera_late_s
        if len(self.route.rests_s):
            return stamps_s
        random = self._random()
        floor_in_base(self.noise, len(times_s), random)  # the stamps' numbers follow those of the floor
        return stamps_s + self.noise.stamp_s * random.normal(size=len(times_s))

    def state_times_s(self) -> FloatArray:
        times_s = np.arange(0, self.route.duration_s, 1 / JOINT_RATE_HZ)
        breaks_s = self.route.drive.breaks_s + self.actual.constants.get("time_wheels", 0.0)
        exact = self.scenario.exact
        return np.unique(np.concatenate([times_s, breaks_s[breaks_s >= 0]])) if exact else times_s

    def joints(self, times_s: FloatArray) -> FloatArray:
        return self.actual.readings(self.route, times_s)

    def wheels(self, times_s: FloatArray, random: np.random.Generator) -> FloatArray:
        late_s = self.actual.constants.get("time_wheels", 0.0)
        angles = self.route.drive.wheel_angles(times_s - late_s, self.robot.wheels, self.robot.slip)
        if self.scenario.exact:
            return angles
        noise = replace(self.noise, wheel_rad_per_sqrt_rad=WHEEL_NOISE_RAD_PER_SQRT_RAD)
        leg = np.searchsorted(station_times_s(self.route), times_s)
        # The first angle twice: every reading has random numbers of its own.
        return self.stepped(rolled_as_read(np.concatenate([angles[:1], angles]), leg, noise, random)[1:])

    def truth(self) -> str:
        levels = {name: getattr(self.noise, name) for name in ("floor_rad", "floor_m", "wheel_share")}
        levels["stamp_s"] = self.noise.stamp_s if self.scenario.motion == "moving" else 0.0
        lines = [
            *(f"  {name}: {decimal(level)}" for name, level in levels.items()),
            "constants:  # true minus stated value: rad, m, s, or a share (of the image width for images)",
            *(f"  {name}: {decimal(value)}" for name, value in self.actual.constants.items()),
        ]
        return World.truth(self).replace("board_in_world:", "\n".join([*lines, "board_in_world:"]), 1)
