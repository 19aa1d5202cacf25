"""Parameters of ros2_control's diff_drive_controller."""

from __future__ import annotations

from collections.abc import Mapping

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.rig import SIDES, Side


def export(of: Source, wheel_joints: Mapping[Side, str]) -> Exported:
    """Parameters of `diff_drive_controller`"""
    # The controller takes one wheel radius and one separation, each with multipliers. The multipliers refer to the
    # nominal sizes; without these, the radius is the mean of both and the multiplier of the separation is 1.
    # Unobservable sizes are left out, so that the controller keeps its own.
    robot = of.robot
    no_radius, no_separation = bool(robot.unobservable[6:8].any()), bool(robot.unobservable[8])
    again = "record again with straight drives and turns"
    if no_radius and robot.odometry is not None:
        raise ConfigError("the calibration determines no factor of the odometry", again)
    if no_radius and no_separation:
        raise ConfigError("the calibration determines neither the wheel radii nor the separation", again)
    base, sizes = "the nominal sizes", robot.nominal_wheels
    if sizes is None:
        base, sizes = "the mean of both radii and the calibrated separation", robot.wheels
    every = {**robot.side_joints, **{side: (name,) for side, name in wheel_joints.items()}}
    text = rendered(
        "ros2_control.yaml",
        robot=robot,
        joints=[(side, every[side]) for side in SIDES if side in every],
        base=base,
        radius_m=(sizes.radius_left_m + sizes.radius_right_m) / 2,
        separation_m=sizes.separation_m,
        no_radius=no_radius,
        no_separation=no_separation,
        factors=robot.factors,
        std=robot.factors_std,
    )
    return Exported(text.encode())
