"""The nine parameters with their covariance as JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.export.formats import CONVENTION, Exported, Source, chain_note, rectified_note
from mobilecal_cli.export.params import names_and_units


def export(of: Source) -> Exported:
    """The nine parameters with their covariance"""
    robot, T, known = of.robot, of.robot.T_parent_child, of.robot.knowledge
    order, units = names_and_units(robot.odometry)
    names = ("radius_left_m", "radius_right_m", "separation_m")
    wheels: dict[str, Any] = {name: getattr(robot.wheels, name) for name in names}
    if robot.odometry is not None:
        factors = {**robot.factors, "std": robot.factors_std}
        assumed_m = robot.odometry.wheels.separation_m
        wheels = {"odometry": {"topic": robot.odometry.topic, **factors, "assumed_separation_m": assumed_m}}
    data: dict[str, Any] = {
        "convention": CONVENTION,
        "parent_frame": robot.parent_frame,
        "child_frame": robot.child_frame,
        "child_frame_images": "rectified" if robot.rectified else "raw",
        "T_parent_child": T.tolist(),
        "translation_m": T[:3, 3].tolist(),
        "quaternion_xyzw": se3.quaternion_xyzw(T[:3, :3]).tolist(),
        **wheels,
        "order": order,
        "covariance": None if known is None else (known.covariance / np.outer(units, units)).tolist(),
        "observable": None if known is None else known.observable.tolist(),
        "verdict": robot.verdict or None,
        "verdict_reasons": list(robot.reasons),
        "created": robot.created,
    }
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    return Exported(text.encode(), (*chain_note(robot), *rectified_note(robot)), states_verdict=True)
