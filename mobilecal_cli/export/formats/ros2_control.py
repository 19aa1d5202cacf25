"""Parameters of ros2_control's diff_drive_controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.text import decimal, quoted
from mobilecal_cli.model import FACTORS, SIDES, CalibratedRobot, Side
from mobilecal_cli.model.text import visible


def export(of: Source, wheel_joints: Mapping[Side, str]) -> Exported:
    """Parameters of `diff_drive_controller`"""
    return Exported(diff_drive_yaml(of.robot, wheel_joints).encode())


def diff_drive_yaml(robot: CalibratedRobot, joints: Mapping[Side, str]) -> str:
    """Parameters of ros2_control's diff_drive_controller.

    The controller takes one wheel radius and one separation, each with multipliers. The multipliers refer to the
    nominal sizes; without these, the radius is the mean of both and the multiplier of the separation is 1.
    Unobservable sizes are left out, so that the controller keeps its own.

    Args:
        robot: its nominal radii count as their mean.
        joints: names of the wheel joints, as far as they are known.

    Raises:
        ConfigError: all sizes are unobservable.
    """
    if robot.odometry is not None:
        return _factors_yaml(robot, joints)
    wheels, nominal = robot.wheels, robot.nominal_wheels
    radius_m, separation_m = (wheels.radius_left_m + wheels.radius_right_m) / 2, wheels.separation_m
    base = "the mean of both radii and the calibrated separation"
    if nominal is not None:
        radius_m = (nominal.radius_left_m + nominal.radius_right_m) / 2
        separation_m, base = nominal.separation_m, "the nominal sizes"
    left, right = decimal(wheels.radius_left_m), decimal(wheels.radius_right_m)
    calibrated = [f"left radius {left}", f"right radius {right}"]
    sizes = [
        f"    wheel_radius: {decimal(radius_m)}",
        f"    left_wheel_radius_multiplier: {decimal(wheels.radius_left_m / radius_m)}",
        f"    right_wheel_radius_multiplier: {decimal(wheels.radius_right_m / radius_m)}",
    ]
    if robot.unobservable[6:8].any():
        calibrated, sizes = [], ["    # Unobservable: keep the wheel_radius of your controller."]
    if robot.unobservable[8]:
        sizes.append("    # Unobservable: keep the wheel_separation of your controller.")
    else:
        calibrated.append(f"separation {decimal(wheels.separation_m)}")
        sizes += [
            f"    wheel_separation: {decimal(separation_m)}",
            f"    wheel_separation_multiplier: {decimal(wheels.separation_m / separation_m)}",
        ]
    if not calibrated:
        raise ConfigError(
            "the calibration determines neither the wheel radii nor the separation",
            "record again with straight drives and turns",
        )
    about = [f"# Lengths in m. The multipliers refer to {base}. Calibrated:", f"# {', '.join(calibrated)}."]
    return _controller(about, robot, joints, sizes)


def _controller(
    about: Sequence[str], robot: CalibratedRobot, joints: Mapping[Side, str], sizes: Sequence[str]
) -> str:
    """The file: comments, names of the wheel joints as far as they are known, and sizes."""
    every = {**robot.side_joints, **{side: (name,) for side, name in joints.items()}}
    names = [
        f"    {side}_wheel_names: [{', '.join(quoted(name) for name in every[side])}]"
        for side in SIDES
        if side in every
    ]
    return "\n".join([*about, "diff_drive_controller:", "  ros__parameters:", *names, *sizes, ""])


def _factors_yaml(robot: CalibratedRobot, joints: Mapping[Side, str]) -> str:
    """The multipliers of a driver whose wheels are unknown, and the scales that other drivers take."""
    assert robot.odometry is not None
    values = dict(zip(FACTORS, (decimal(value) for value in robot.factors.tolist()), strict=True))
    std = dict(zip(FACTORS, robot.factors_std.tolist(), strict=False))
    hidden = {
        "left_wheel_radius_multiplier": bool(robot.unobservable[6:8].any()),
        "right_wheel_radius_multiplier": bool(robot.unobservable[6:8].any()),
        "wheel_separation_multiplier": bool(robot.unobservable[6:].any()),
    }
    if all(hidden.values()):
        raise ConfigError(
            "the calibration determines no factor of the odometry",
            "record again with straight drives and turns",
        )

    def line(name: str) -> str:
        if hidden[name]:
            return f"    # {name} is unobservable: keep that of your controller."
        sigma = f"  # +- {std[name]:.2g}" if name in std else ""
        return f"    {name}: {values[name]}{sigma}"

    separation = decimal(robot.odometry.wheels.separation_m)
    scales = ", ".join(f"{name} {values[name]}" for name in ("linear_scale", "angular_scale"))
    about = [
        f"# Factors of the odometry on {visible(robot.odometry.topic)}. Keep wheel_radius and wheel_separation of",
        "# your driver, and multiply multipliers that it has already by these. The difference between the",
        f"# multipliers of the two radii holds for a wheel_separation of {separation} m.",
        *([] if any(hidden.values()) else [f"# For drivers that scale distance and rotation: {scales}."]),
    ]
    return _controller(about, robot, joints, [line(name) for name in hidden])
