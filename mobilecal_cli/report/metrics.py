"""Figures of a calibration and of an evaluation, in one table: names, units, and whether a limit is a lower one.

The name of a figure is its gate, its key in `metrics` of report.json, and the id of the criterion that judges it. If a
name ends in a unit, the value has this unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mobilecal_cli.model import AtWork
from mobilecal_cli.report.parameters import PARAMETERS


@dataclass(frozen=True, slots=True)
class Metric:
    """One figure.

    Attributes:
        name: for `--gate`, report.json and criteria; of a criterion without a gate, the part before the first dot may
            stand for all its parts.
        unit: of its values and limits, "" for counts and ratios.
        at_least: whether its limit is a lower one.
    """

    name: str
    unit: str = ""
    at_least: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """One expected error in use.

    Attributes:
        field: of `AtWork`.
        name: see `Metric`.
        meaning: label.
        unit: for people.
        factor: how many of it one unit of the field is.
        limit: default limit in this unit; None for no limit.
    """

    field: str
    name: str
    meaning: str
    unit: str
    factor: float
    limit: float | None = None

    def of(self, expected: AtWork) -> float:
        """The figure in its unit."""
        return float(getattr(expected, self.field)) * self.factor


_DEG = 180 / math.pi
# fmt: off
FIGURES = (
    Figure("camera_m", "predicted.camera_mm", "camera position in the base", "mm", 1e3, 20.0),
    Figure("camera_rad", "predicted.camera_deg", "camera rotation in the base", "deg", _DEG, 1.0),
    Figure("point_m", "predicted.point_mm", "point 2 m in front of the camera", "mm", 1e3),
    Figure("along_m_per_m", "predicted.along_mm_per_m", "distance by dead reckoning, driving straight", "mm/m", 1e3,
           10.0),
    Figure("sideways_m_per_m", "predicted.sideways_mm_per_m", "lateral position by dead reckoning after one meter",
           "mm/m", 1e3),
    Figure("heading_rad_per_m", "predicted.heading_deg_per_m", "heading by dead reckoning, driving straight", "deg/m",
           _DEG, 1.0),
    Figure("heading_rad_per_turn", "predicted.heading_deg_per_turn", "heading by dead reckoning per full turn", "deg",
           _DEG, 5.0),
)
# fmt: on

_EVALUATION = (
    Metric("stations", at_least=True),
    Metric("legs", at_least=True),
    Metric("reprojection_rms_px", "px"),
    Metric("rotation_rms_deg", "deg"),
    Metric("translation_rms_mm", "mm"),
    Metric("drift_mm_per_m", "mm/m"),
    Metric("drift_deg_per_turn", "deg"),
)
_CALIBRATION = (
    *_EVALUATION[:3],
    Metric("point_rms_mm", "mm"),
    Metric("left_out"),
    *(Metric(parameter.gate, parameter.unit) for parameter in PARAMETERS),
    *(Metric(figure.name, figure.unit) for figure in FIGURES),
    *(Metric(f"hold_out.{metric.name}", metric.unit, metric.at_least) for metric in _EVALUATION),
    Metric("change", "%", at_least=True),
    Metric("description", "sigma"),
    Metric("leg_outlier.point", "mm"),
    Metric("leg_outlier.reprojection", "px"),
    Metric("methods"),
    Metric("motion.driven_m", "m", at_least=True),
    Metric("motion.pan_range_deg", "degrees", at_least=True),
    Metric("motion.tilt_range_deg", "degrees", at_least=True),
    Metric("motion.turned_deg", "degrees", at_least=True),
    Metric("noise.floor", "degrees"),
    Metric("noise.height", "mm"),
    Metric("noise.joint", "degrees"),
    Metric("noise.sliding_joint", "mm"),
    Metric("noise.stamp", "ms"),
    Metric("noise.wheel", "rad per sqrt(rad)"),
    Metric("noise.wheel_share", "%"),
    Metric("nominal.radius_left", "%"),
    Metric("nominal.radius_right", "%"),
    Metric("nominal.separation", "%"),
    Metric("observable", at_least=True),
    Metric("outliers", "%"),
    Metric("point_error", "%"),
    Metric("rejected", "%"),
    Metric("reprojection_error", "px"),
    Metric("second_solution", at_least=True),
    Metric("square_size", "%"),
    Metric("stereo_error", "px"),
    Metric("wheel_difference", "%"),
)
#: Criteria without a gate: those that arise only where something is wrong, and those of an evaluation.
_OTHERS = (
    Metric("camera_info"),
    Metric("contradiction", "sigma"),
    Metric("jump", "sigma"),
    Metric("mistake", "%"),
    Metric("outliers_as_noise"),
    Metric("agreement.camera_rotation", "deg"),
    Metric("agreement.camera_position", "mm"),
    Metric("agreement.radius_right", "%"),
    Metric("agreement.radius_left", "%"),
    Metric("agreement.separation", "%"),
    Metric("corner_error", "px"),
    Metric("evaluated_stations", at_least=True),
    Metric("own_estimate"),
)
METRICS = {metric.name: metric for metric in (*_EVALUATION, *_CALIBRATION, *_OTHERS)}


def gate_names(*, evaluating: bool = False) -> tuple[str, ...]:
    """Names of the figures that a gate of `calibrate` (or of `evaluate`) can limit."""
    return tuple(metric.name for metric in (_EVALUATION if evaluating else _CALIBRATION))


def metric_of(check: str) -> Metric:
    """The row of a criterion, by its id; a gate ("gate.stations") has that of its figure.

    Raises:
        KeyError: there is none.
    """
    name = check.removeprefix("gate.")
    return METRICS.get(name) or METRICS[name.partition(".")[0]]
