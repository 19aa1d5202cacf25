"""Planned routes in front of the board: stops of the base, motion between them, and the head's joint angles.

The base moves in segments of constant speed, integrated as exact arcs, independently of the solver's dead reckoning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import Board, WheelGeometry
from mobilecal_cli.simulate.robot import OPTICAL, SimulatedRobot, pixels, pose
from mobilecal_cli.targets import Motion

#: The board in front of a simulated robot.
CHECKERBOARD = Board(9, 6, 0.08)
_STRAIGHT_RADPS = 1e-12  # of turns that make no difference


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time segment with constant speeds.

    Attributes:
        duration_s: duration, s.
        v_mps: forward speed of the base's origin, m/s.
        w_radps: turning rate, rad/s, positive to the left.
    """

    duration_s: float
    v_mps: float = 0.0
    w_radps: float = 0.0


Pose = tuple[float, float, float]


def moved(pose: Pose, stretch: Stretch, time_s: float) -> Pose:
    """Base pose (x m, y m, heading rad) after a given time in a segment."""
    x, y, heading = pose
    if abs(stretch.w_radps) < _STRAIGHT_RADPS:
        run = stretch.v_mps * time_s
        return x + run * math.cos(heading), y + run * math.sin(heading), heading
    radius = stretch.v_mps / stretch.w_radps
    centre_x, centre_y = x - radius * math.sin(heading), y + radius * math.cos(heading)
    heading += stretch.w_radps * time_s
    return centre_x + radius * math.sin(heading), centre_y - radius * math.cos(heading), heading


def slipping_radps(stretch: Stretch) -> float:
    """Turning rate that the slip depends on: it grows up to twice the rate of turns in place."""
    return min(abs(stretch.w_radps), 2 * TURN_RADPS)


def wheel_speeds(stretch: Stretch, wheels: WheelGeometry, slip: float = 0.0) -> tuple[float, float]:
    """Right and left wheel speeds, rad/s, for rolling without slip, or with a slip that grows with the turning rate."""
    half = wheels.separation_m / 2 * (1 + slip * (slipping_radps(stretch) - TURN_RADPS))
    right = (stretch.v_mps + stretch.w_radps * half) / wheels.radius_right_m
    left = (stretch.v_mps - stretch.w_radps * half) / wheels.radius_left_m
    return right, left


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A complete drive.

    Attributes:
        stretches: consecutive segments, from the origin.
    """

    stretches: tuple[Stretch, ...]

    @property
    def breaks_s(self) -> FloatArray:
        """(B + 1,) boundaries between the segments, s, from 0."""
        return np.concatenate([[0.0], np.cumsum([s.duration_s for s in self.stretches])])

    def poses(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) base poses at given times."""
        at_breaks: list[Pose] = [(0.0, 0.0, 0.0)]
        for stretch in self.stretches:
            at_breaks.append(moved(at_breaks[-1], stretch, stretch.duration_s))
        breaks = self.breaks_s
        index = np.clip(np.searchsorted(breaks, times_s, side="right") - 1, 0, len(self.stretches) - 1)
        return np.array(
            [
                moved(at_breaks[i], self.stretches[i], t - breaks[i])
                for i, t in zip(index, times_s, strict=True)
            ]
        )

    def wheel_angles(self, times_s: FloatArray, wheels: WheelGeometry, slip: float = 0.0) -> FloatArray:
        """(n, 2) rotations of the right and left wheel since the start, rad; linear inside a segment."""
        speeds = np.array([wheel_speeds(stretch, wheels, slip) for stretch in self.stretches])
        rolled = np.cumsum(speeds * [[stretch.duration_s] for stretch in self.stretches], axis=0)
        angles = np.concatenate([np.zeros((1, 2)), rolled])
        return np.stack([np.interp(times_s, self.breaks_s, angles[:, k]) for k in (0, 1)], axis=1)


def base_in_world(poses: FloatArray) -> FloatArray:
    """T_w_v of base poses: (n, 3) → (n, 4, 4)."""
    return se3.transform(se3.rotation_z(poses[:, 2]), poses * [1, 1, 0])


REST_S = 1.2  # at a stop: enough for what finds rests
_SPEED_MPS = 0.3  # of drives between stops, as indoors
TURN_RADPS = 0.7  # of turns in place
_MARGIN_PX = 22.0  # around the board in the images, which the detection needs
_SMALLEST_SQUARE_PX = 11.0  # the detection needs 7
_NEAREST_M, _FARTHEST_M = 1.05, 2.5  # a stop from the board's center
_TRIES, _TURNS_TRIED = 4000, 200  # random legs before a route is given up, at rests and in motion
_LARGE_TURN_PLANS = 40  # about a third of the plans contain no large turn
_KNOT_S = 1.0  # between changes of motion on a moving route


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Motion of the base and the head, and the pose of the board.

    Attributes:
        motion: kind of motion.
        drive: motion of the base.
        knots_s: (K,) times of the joint setpoints, s.
        knots_rad: (K, J) joint setpoints, rad.
        rests_s: (R, 2) start and end of every rest, s; empty for a moving route.
        T_w_k: (4, 4) board coordinates to world coordinates.
        board: the checkerboard, with known square size.
    """

    motion: Motion
    drive: Drive
    knots_s: FloatArray
    knots_rad: FloatArray
    rests_s: FloatArray
    T_w_k: FloatArray
    board: Board

    @property
    def duration_s(self) -> float:
        """Duration of the recording, s."""
        return float(self.drive.breaks_s[-1])

    def joints(self, times_s: FloatArray) -> FloatArray:
        """(n, J) joint angles, rad: smooth between setpoints, constant during rests."""
        if self.motion == "moving":
            return np.asarray(CubicSpline(self.knots_s, self.knots_rad)(times_s), dtype=np.float64)
        index = np.clip(np.searchsorted(self.knots_s, times_s, side="right") - 1, 0, len(self.knots_s) - 2)
        span = self.knots_s[index + 1] - self.knots_s[index]
        share = np.clip((times_s - self.knots_s[index]) / span, 0, 1)
        smooth = (share**2 * (3 - 2 * share))[:, None]
        return np.asarray((1 - smooth) * self.knots_rad[index] + smooth * self.knots_rad[index + 1])


def board_in_world(board: Board, distance_m: float, height_m: float) -> FloatArray:
    """T_w_k of an upright board that faces the robot with a small rotation, (4, 4)."""
    askew = Rotation.from_euler("xyz", [2.0, 6.0, -1.5], degrees=True)
    square = board.square_m or 0.0
    centre = square * np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0.0])
    rotation = OPTICAL * askew
    return pose(np.array([distance_m, 0.0, height_m]) - rotation.apply(centre), rotation)


class Planner:
    """Plans routes for one robot, with all random choices from one generator."""

    def __init__(self, robot: SimulatedRobot, board: Board, random: np.random.Generator) -> None:
        self.robot = robot
        self.random = random
        self.board = board
        T_v_h = robot.head_pose(np.zeros(len(robot.joint_names)))
        self.T_w_k = board_in_world(board, 2.1, float((T_v_h @ robot.T_h_c)[2, 3]) - 0.05)
        self._corners_k = board.grid() * (board.square_m or 0.0)
        self.centre_w = (self.T_w_k @ [*self._corners_k.mean(axis=0), 1.0])[:3]
        names = robot.joint_names
        self._aim = [(k, names.index(name)) for k, name in enumerate((robot.pan, robot.tilt)) if name]

    def sees_board(self, base: Pose, joints_rad: FloatArray) -> bool:
        """Whether the images show the whole board, with squares large enough for detection."""
        rig = self.robot.rig_cameras
        T_w_c = base_in_world(np.array([base]))[0] @ self.robot.head_pose(joints_rad) @ self.robot.T_h_c
        # Other cameras than a stereo pair need not show the board together.
        for camera, T_c_x in list(zip(rig.each, rig.T_c_each, strict=True))[: 2 if rig.calibrated else 1]:
            T_x_k = np.linalg.inv(T_w_c @ T_c_x) @ self.T_w_k
            at = pixels(camera, self._corners_k @ T_x_k[:3, :3].T + T_x_k[:3, 3])
            if at.min() < _MARGIN_PX or np.any(at > np.array([camera.width, camera.height]) - 1 - _MARGIN_PX):
                return False
            grid = at.reshape(self.board.rows, self.board.columns, 2)
            edges = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
            if min(edges) < _SMALLEST_SQUARE_PX:
                return False
        return True

    def look_at(self, base: Pose, point_w: FloatArray, resting_rad: FloatArray) -> FloatArray:
        """Joint angles, (J,), that point the first camera at a point by pan and tilt."""
        if not self._aim:
            return np.array(resting_rad)
        T_v_w = np.linalg.inv(base_in_world(np.array([base]))[0])
        point_v = T_v_w @ [*point_w, 1.0]

        def beside(aim: FloatArray) -> FloatArray:
            joints = self._aimed(resting_rad, aim)
            point_c = np.linalg.inv(self.robot.head_pose(joints) @ self.robot.T_h_c) @ point_v
            return np.asarray(point_c[:2] / max(float(point_c[2]), 0.1))

        aim = least_squares(beside, [math.atan2(point_v[1], point_v[0]), 0.0]).x
        return self._aimed(resting_rad, aim)

    def _aimed(self, resting_rad: FloatArray, aim: FloatArray) -> FloatArray:
        joints = np.array(resting_rad)
        for of_aim, joint in self._aim:
            joints[joint] = aim[of_aim]
        return joints

    def gaze(self, base: Pose) -> FloatArray | None:
        """Joint angles with the whole board in view, aimed near its center; None if there are none."""
        limits_rad = np.array([joint.limit_rad for joint in self.robot.joints if joint.name])
        for reach in (0.30, 0.22, 0.15, 0.08):
            point = self.centre_w + self.random.uniform(-reach, reach, 3)
            body = self.random.uniform(-0.08, 0.08, len(limits_rad))  # joints other than pan and tilt
            joints = self.look_at(base, point, body)
            if np.all(np.abs(joints) <= limits_rad) and self.sees_board(base, joints):
                return joints
        return None

    def looking(self, base: Pose, motion: Motion, first: FloatArray) -> FloatArray | None:
        """Joint angles for a stop, None if the board is not in view; `first` is for a fixed head."""
        if motion not in ("head_fixed", "pan_only"):
            return self.gaze(base)
        joints = first
        if motion == "pan_only":
            point = self.centre_w + self.random.uniform(-0.2, 0.2, 3)
            joints = np.zeros(len(self.robot.joint_names))
            for of_aim, joint in self._aim:
                if of_aim == 0:
                    joints[joint] = self.look_at(base, point, joints)[joint]
        return joints if self.sees_board(base, joints) else None

    def leg(self, base: Pose, motion: Motion) -> list[Stretch]:
        """Random motion from a pose: turn, drive (on an arc), turn."""
        random = self.random
        turn, run, bend = random.uniform(-0.7, 0.7), random.uniform(-0.9, 0.9), random.uniform(-0.5, 0.5)
        facing = math.atan2(self.centre_w[1] - base[1], self.centre_w[0] - base[0])
        if motion == "base_fixed":
            return []
        if motion == "straight":
            return [Stretch(abs(run) / _SPEED_MPS, math.copysign(_SPEED_MPS, run))]
        if motion == "spin":
            aim = facing + random.uniform(-0.7, 0.7) - base[2]
            return [Stretch(abs(aim) / TURN_RADPS, 0.0, math.copysign(TURN_RADPS, aim))]
        first = Stretch(abs(turn) / TURN_RADPS, 0.0, math.copysign(TURN_RADPS, turn))
        duration = abs(run) / _SPEED_MPS
        arc = Stretch(duration, math.copysign(_SPEED_MPS, run), bend / duration)
        there = moved(moved(base, first, first.duration_s), arc, arc.duration_s)
        facing = math.atan2(self.centre_w[1] - there[1], self.centre_w[0] - there[0])
        still = motion == "head_fixed" or not self._aim
        spread = 0.12 if still else 1.1 if motion == "large_turns" else 0.6
        last_turn = math.remainder(facing - there[2], 2 * math.pi) + random.uniform(-spread, spread)
        # Turn in the opposite direction, if the leg's turn is then at most 300 degrees (360 without a head).
        if motion == "large_turns":
            total = there[2] - base[2] + last_turn
            other, most = total - math.copysign(2 * math.pi, total), math.radians(300 if self._aim else 360)
            last_turn = last_turn + other - total if abs(other) <= most else last_turn
        last = Stretch(abs(last_turn) / TURN_RADPS, 0.0, math.copysign(TURN_RADPS, last_turn))
        return [s for s in (first, arc, last) if s.duration_s > 0]

    def allowed(self, base: Pose) -> bool:
        """Whether a pose is suitable for a stop."""
        distance = math.hypot(self.centre_w[0] - base[0], self.centre_w[1] - base[1])
        return _NEAREST_M < distance < _FARTHEST_M and abs(base[1]) < 0.9 and base[0] < self.centre_w[0] - 0.9


def plan_stops(planner: Planner, motion: Motion, stations: int) -> Route:
    """Plan a route that stops at every station.

    Raises:
        ConfigError: the board cannot be kept in view (unusual size of the robot or the board).
    """
    base: Pose = (0.0, 0.0, 0.0)
    fixed = planner.look_at(base, planner.centre_w, np.zeros(len(planner.robot.joint_names)))
    first = planner.looking(base, motion, fixed)
    if first is None:
        raise ConfigError(
            "the simulated robot cannot see the whole board from its start pose", "use a smaller board"
        )
    clock, stretches, rests_s, gazes = REST_S, [Stretch(REST_S)], [(0.0, REST_S)], [first]
    tries = 0
    while len(rests_s) < stations:
        tries += 1
        if tries > _TRIES:
            raise ConfigError(
                f"no route found for motion {motion!r}: only {len(rests_s)} of {stations} stations see the whole board "
                f"after {_TRIES} tries",
                "use fewer stations or a smaller board",
            )
        way = planner.leg(base, motion)
        there = base
        for stretch in way:
            there = moved(there, stretch, stretch.duration_s)
        joints = planner.looking(there, motion, fixed) if planner.allowed(there) else None
        if joints is None:
            continue
        way = way or [Stretch(1.5)]
        duration = sum(stretch.duration_s for stretch in way)
        stretches += [*way, Stretch(REST_S)]
        rests_s.append((clock + duration, clock + duration + REST_S))
        gazes.append(joints)
        clock += duration + REST_S
        base = there
    drive, knots = Drive(tuple(stretches)), np.repeat(gazes, 2, axis=0)  # the head stands still at a stop
    return Route(motion, drive, np.ravel(rests_s), knots, np.array(rests_s), planner.T_w_k, planner.board)


def plan_moving(planner: Planner, duration_s: float) -> Route:
    """Plan a route without rests: the base drives on arcs, and the head follows the board."""
    base: Pose = (0.0, 0.0, 0.0)
    random = planner.random
    stretches, gazes, knots_s, clock = list[Stretch](), list[FloatArray](), list[float](), 0.0
    while clock < duration_s:
        for _ in range(_TURNS_TRIED):
            speed = random.choice([-1, 1]) * random.uniform(0.08, 0.25)
            stretch = Stretch(_KNOT_S, speed, random.uniform(-0.45, 0.45))
            there = moved(base, stretch, _KNOT_S)
            # A head follows the board; a camera on the base must still see it when the base has moved.
            looking = base if planner.robot.joint_names else there
            gaze = planner.gaze(looking) if planner.allowed(there) and abs(there[2]) < 0.9 else None
            if gaze is not None:
                break
        else:
            raise ConfigError("no moving route found that keeps the board in view", "use a smaller board")
        stretches.append(stretch)
        gazes.append(gaze)
        knots_s.append(clock)
        clock, base = clock + _KNOT_S, there
    knots = np.array([*gazes, gazes[-1]])
    no_rests = np.zeros((0, 2))
    drive = Drive(tuple(stretches))
    return Route("moving", drive, np.array([*knots_s, clock]), knots, no_rests, planner.T_w_k, planner.board)


@lru_cache(maxsize=256)
def plan_route(
    robot: SimulatedRobot,
    motion: Motion = "standard",
    stations: int = 12,
    board: Board = CHECKERBOARD,
    seed: int = 0,
) -> Route:
    """Plan a route that keeps the board in view.

    Args:
        motion: "standard", a motion with unobservable parameters, or "moving", which never rests.
        stations: number of stops; a moving route takes three seconds per station.
        board: with known square size.
        seed: of all random choices.

    Raises:
        ConfigError: the board cannot be kept in view.
    """
    planner = Planner(robot, board, np.random.default_rng([seed, 1]))
    if motion == "moving":
        return plan_moving(planner, 3.0 * stations)
    for _ in range(_LARGE_TURN_PLANS):
        route = plan_stops(planner, motion, stations)
        headings_rad = route.drive.poses(route.rests_s.mean(axis=1))[:, 2]
        if motion != "large_turns" or np.abs(np.diff(headings_rad)).max(initial=0.0) > math.pi:
            return route
    raise ConfigError(
        f"no route of {stations} stations contains a turn of more than 180 degrees between two of them",
        "use more stations",
    )
