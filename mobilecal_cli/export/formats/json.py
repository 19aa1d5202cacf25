"""The nine parameters with their covariance as JSON."""

from __future__ import annotations

import json
from typing import Any

from mobilecal_cli import se3
from mobilecal_cli.export.formats import CONVENTION, HeadEyeFormat
from mobilecal_cli.model import NINE, CalibratedRobot


class Json(HeadEyeFormat):
    """The nine parameters with their covariance"""

    states_verdict = True

    def text(self, robot: CalibratedRobot) -> str:
        T, known = robot.T_parent_child, robot.knowledge
        data: dict[str, Any] = {
            "convention": CONVENTION,
            "parent_frame": robot.parent_frame,
            "child_frame": robot.child_frame,
            "child_frame_images": "rectified" if robot.rectified else "raw",
            "T_parent_child": T.tolist(),
            "translation_m": T[:3, 3].tolist(),
            "quaternion_xyzw": se3.quaternion_xyzw(T[:3, :3]).tolist(),
            "radius_left_m": robot.wheels.radius_left_m,
            "radius_right_m": robot.wheels.radius_right_m,
            "separation_m": robot.wheels.separation_m,
            "order": list(NINE),
            "covariance": None if known is None else known.covariance.tolist(),
            "observable": None if known is None else known.observable.tolist(),
            "verdict": robot.verdict or None,
            "verdict_reasons": list(robot.reasons),
            "created": robot.created,
        }
        return json.dumps(data, indent=1, allow_nan=False) + "\n"
