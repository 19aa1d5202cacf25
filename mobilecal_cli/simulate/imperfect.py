"""Robots that are not as their description says: constants drawn from priors, and noise of floor and stamps.

A constant is the true minus the stated value; the description, the head-eye transform and the wheels of the
`SimulatedRobot` remain as they are. See `actual` for what each constant does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.model import Extraction
from mobilecal_cli.simulate.actual import DISTORTIONS, ActualRobot, Outside, crosswise, joint_key
from mobilecal_cli.simulate.ideal import Noise, extraction_of
from mobilecal_cli.simulate.robot import SimulatedRobot
from mobilecal_cli.simulate.route import Route

#: Kind of constant → standard deviation of its prior: rad, m, s, or a share.
PRIORS: dict[str, float] = {
    "focal_length": 0.002,
    "principal_point": 0.003,
    "distortion": 0.0008,
    "stereo_rotation": np.radians(0.05),
    "baseline_direction": np.radians(0.1),
    "baseline_length": 0.002,
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
#: First guesses of the noise at each station or leg; the other levels depend on the robot.
STATION_NOISE = Noise(floor_rad=np.radians(0.1), floor_m=0.0005, stamp_s=0.0005, wheel_share=0.001)


@dataclass(frozen=True, slots=True, eq=False)
class Imperfection:
    """What is not as stated.

    Attributes:
        constants: name → true minus stated value; a missing one is zero.
        noise: levels of the noise.
        outside: what no constant describes.
    """

    constants: Mapping[str, float] = field(default_factory=dict)
    noise: Noise = field(default_factory=Noise)
    outside: Outside = field(default_factory=Outside)


def constant_kinds(robot: SimulatedRobot) -> dict[str, str]:
    """All constants of a robot and its board: name → kind."""
    kinds: dict[str, str] = {}
    for side in ("left", "right"):
        kinds[f"focal_{side}"] = "focal_length"
        kinds |= dict.fromkeys((f"principal_{side}_{letter}" for letter in "xy"), "principal_point")
        kinds |= dict.fromkeys((f"distortion_{side}_{term}" for term in DISTORTIONS), "distortion")
    kinds |= dict.fromkeys((f"stereo_r_{letter}" for letter in "xyz"), "stereo_rotation")
    baseline = crosswise(robot.rig_cameras.T_c_r[:3, 3])
    kinds |= dict.fromkeys((f"baseline_{letter}" for letter in baseline), "baseline_direction")
    kinds |= {"baseline_scale": "baseline_length"}
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
    kinds |= {f"focal_aspect_{side}": "focal_aspect" for side in ("left", "right")}
    kinds |= {
        "board_twist": "board_bend",
        "board_shear": "board_shear",
        "lean_roll": "lean",
        "lean_pitch": "lean",
    }
    return kinds | {"time_right": "stereo_clock", "readout": "readout"}


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


def actual_robot(robot: SimulatedRobot, imperfection: Imperfection) -> ActualRobot:
    """The physical robot behind a description.

    Raises:
        ValueError: a constant that the robot does not have.
    """
    if unknown := set(imperfection.constants) - set(constant_kinds(robot)):
        raise ValueError(f"unknown constants: {', '.join(sorted(unknown))}")
    return ActualRobot(robot, imperfection.constants, imperfection.outside)


def imperfect_extraction(
    robot: SimulatedRobot,
    route: Route,
    imperfection: Imperfection,
    seed: int = 0,
    nominal: bool = True,
    camera_late_s: float = 0.0,
    images: int = 40,
) -> Extraction:
    """Extraction of a drive of a robot that is not as stated; see `ideal_extraction`.

    Args:
        robot: the description, with the true head-eye transform and wheels.
        route: the true motion of base and joints; readings follow from it.
        imperfection: what is not as stated, and the noise.
        seed: of the noise.
        nominal: whether nominal values are known.
        camera_late_s: delay of the camera stamps relative to joints and wheels, s.
        images: their number where the robot never rests.

    Raises:
        ConfigError: the cameras' images are too inconsistent to be triangulated.
    """
    actual = actual_robot(robot, imperfection)
    return extraction_of(actual, route, imperfection.noise, seed, nominal, camera_late_s, images)
