"""Robots that are not as their description says: constants drawn from priors, and noise of floor and stamps.

A constant is the true minus the stated value; the description, the head-eye transform and the wheels of the
`SimulatedRobot` remain as they are. See `actual` for what each constant does.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.model import FloatArray, IntArray
from mobilecal_cli.simulate.actual import DISTORTIONS, crosswise, joint_key
from mobilecal_cli.simulate.robot import SimulatedRobot, pose
from mobilecal_cli.simulate.route import Route

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
START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the wheels, the floor and the stamps; zero by default.

    Attributes:
        wheel_rad_per_sqrt_rad: sigma of a wheel's rotation over one radian; grows with the square root.
        floor_rad, floor_m: sigma of the base's roll and pitch, and of its height, at each station.
        stamp_s: sigma of each image stamp in motion, s.
        wheel_share: sigma of each wheel's relative scale error.
    """

    wheel_rad_per_sqrt_rad: float = 0.0
    floor_rad: float = 0.0
    floor_m: float = 0.0
    stamp_s: float = 0.0
    wheel_share: float = 0.0


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
    kinds |= {
        "board_twist": "board_bend",
        "board_shear": "board_shear",
        "lean_roll": "lean",
        "lean_pitch": "lean",
    }
    return kinds | {f"time_{name}": "stereo_clock" for name in rig.names[1:]} | {"readout": "readout"}


def draw(
    robot: SimulatedRobot,
    random: np.random.Generator,
    scale: float = 1.0,
    kinds: Collection[str] | None = None,
) -> dict[str, float]:
    """Constants from their priors: name → value. Each kind gets the same values whichever others are drawn.

    Args:
        robot: the description.
        random: source of the values.
        scale: of the priors' standard deviations.
        kinds: keys of `PRIORS` or names of constants; by default all but those that only moving recordings show.
    """
    of = constant_kinds(robot)
    chosen = set(PRIORS) - _OF_MOTION if kinds is None else set(kinds)
    if unknown := chosen - set(PRIORS) - set(of):
        raise ValueError(f"unknown kinds or constants: {', '.join(sorted(unknown))}")
    units = dict(zip(of, random.normal(size=len(of)), strict=True))
    return {
        name: float(scale * PRIORS[kind] * units[name])
        for name, kind in of.items()
        if name in chosen or kind in chosen
    }


def station_times_s(route: Route, stations: int = 40) -> FloatArray:
    """Middle of every rest; on a route without rests, equally spaced times."""
    if len(route.rests_s):
        return np.asarray(route.rests_s.mean(axis=1))
    return np.linspace(0.5, route.duration_s - 0.5, stations)


def nanoseconds(times_s: FloatArray) -> IntArray:
    """Header stamps for times of a recording, int64 ns."""
    return np.asarray(START_NS + np.round(np.asarray(times_s) * 1e9).astype(np.int64), dtype=np.int64)


def floor_in_base(noise: Noise, count: int, random: np.random.Generator, still: bool = False) -> FloatArray:
    """Roll, pitch and height of the base on an uneven floor, at each of some stations: (N, 4, 4), base axes."""
    return floor_poses(noise, random.normal(size=(count, 2)), random.normal(size=count), still)


def floor_poses(noise: Noise, turns: FloatArray, lifts: FloatArray, still: bool) -> FloatArray:
    """Poses (N, 4, 4) of the base from unit random numbers; the same at all stations of a base that stands still.

    Args:
        noise: its levels.
        turns, lifts: (N, 2) and (N,).
        still: whether the base never moves.
    """
    poses = np.array(
        [
            pose((0.0, 0.0, float(lift)), Rotation.from_rotvec([roll, pitch, 0.0]))
            for (roll, pitch), lift in zip(noise.floor_rad * turns, noise.floor_m * lifts, strict=True)
        ]
    )
    return np.repeat(poses[:1], len(poses), axis=0) if still else poses


def rolled_as_read(
    angles: FloatArray, leg: IntArray, noise: Noise, random: np.random.Generator
) -> FloatArray:
    """Wheel rotations with noise, before the encoders' steps.

    Args:
        angles: (n, 2) true rotations of the right and left wheel, rad.
        leg: (n - 1,) leg of each change, from 0.
        noise: their levels.
        random: source of the noise.
    """
    change = np.diff(angles, axis=0)
    error = np.zeros(change.shape)
    if noise.wheel_rad_per_sqrt_rad:
        error += random.normal(size=change.shape) * noise.wheel_rad_per_sqrt_rad * np.sqrt(np.abs(change))
    if noise.wheel_share:
        error += noise.wheel_share * random.normal(size=(int(leg.max()) + 1, 2))[leg] * change
    return np.asarray(angles + np.concatenate([np.zeros((1, 2)), np.cumsum(error, axis=0)]))
