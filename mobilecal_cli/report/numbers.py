"""The numbers that every part of the report shows, worked out in one place, and how they are written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import encoder_step_rad
from mobilecal_cli.model import NINE, Extraction, FloatArray, Parameters, Rejection, Solution, StereoRig

#: Nearer to gimbal lock than this, two of the angles have no meaning one by one.
NEAR_LOCK_DEG = 5.0
_ANGLE_STEP_RAD = 1e-5


@dataclass(frozen=True, slots=True)
class Quantity:
    """One of the nine numbers, in the units of the paper's Table 1.

    Attributes:
        key: name in report.json, with its unit.
        symbol: as the paper writes it.
        meaning: in words.
        unit: "deg" or "mm".
        digits: decimals worth showing.
    """

    key: str
    symbol: str
    meaning: str
    unit: str
    digits: int


QUANTITIES = (
    Quantity("euler_x_deg", "αx", "camera's rotation about x", "deg", 3),
    Quantity("euler_y_deg", "αy", "camera's rotation about y", "deg", 3),
    Quantity("euler_z_deg", "αz", "camera's rotation about z", "deg", 3),
    Quantity("translation_x_mm", "tx", "camera's position on the head, x", "mm", 2),
    Quantity("translation_y_mm", "ty", "camera's position on the head, y", "mm", 2),
    Quantity("translation_z_mm", "tz", "camera's position on the head, z", "mm", 2),
    Quantity("radius_right_mm", "rR", "right wheel's radius", "mm", 2),
    Quantity("radius_left_mm", "rL", "left wheel's radius", "mm", 2),
    Quantity("separation_mm", "b", "distance between the wheels", "mm", 2),
)


def reference_pose(parameters: Parameters, cameras: StereoRig) -> FloatArray:
    """(4, 4) reference camera coordinates to head coordinates, m."""
    T: FloatArray = parameters.T_h_c @ cameras.T_c_reference
    return T


def reference_frame(cameras: StereoRig) -> str:
    """Name of the reference camera's optical frame."""
    return (cameras.left if cameras.reference == "left" else cameras.right).frame_id


def nine_numbers(parameters: Parameters, cameras: StereoRig) -> FloatArray:
    """(9,) in the order and units of `QUANTITIES`."""
    T = reference_pose(parameters, cameras)
    wheels = parameters.wheels
    lengths_m = [*T[:3, 3], wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]
    return np.array([*se3.euler_zyx_deg(T[:3, :3]), *(1e3 * length for length in lengths_m)])


@dataclass(frozen=True, slots=True)
class Sigma:
    """How well one of the nine numbers is known.

    Attributes:
        name: as in params.yaml.
        meaning: in words.
        value: one standard deviation, None where the number is held at its nominal value.
        unit: "deg" or "mm".
    """

    name: str
    meaning: str
    value: float | None
    unit: str


def sigmas(solution: Solution, cameras: StereoRig) -> tuple[Sigma, ...]:
    """Standard deviations in degrees and mm; none for methods that know none."""
    std = reference_std(solution, cameras)
    if not std:
        return ()
    meanings = [
        *(f"camera's rotation about the head's {axis}" for axis in "xyz"),
        *(quantity.meaning for quantity in QUANTITIES[3:]),
    ]
    units = [("deg", float(np.degrees(1.0)))] * 3 + [("mm", 1e3)] * 6
    return tuple(
        Sigma(name, meaning, None if s is None else s * factor, unit)
        for name, meaning, s, (unit, factor) in zip(NINE, meanings, std, units, strict=True)
    )


def reference_std(solution: Solution, cameras: StereoRig) -> tuple[float | None, ...]:
    """Nine standard deviations of the reference camera's numbers and the wheels, rad and m; None where one is held.

    Empty for methods that know none.
    """
    found = solution.uncertainty
    if found is None:
        return ()
    std = np.sqrt(np.diag(found.referred(solution.parameters.T_h_c, cameras.T_c_reference)))
    return tuple(float(s) if seen else None for s, seen in zip(std, found.observable, strict=True))


def nine_std(solution: Solution, cameras: StereoRig) -> tuple[float | None, ...]:
    """Nine standard deviations in the order and units of `QUANTITIES`, None where one is held or means nothing.

    Those of the angles are carried over from the small rotation vector, `R_true = exp(r) R`, to first order; near
    gimbal lock, where x and z trade places, there are none. Empty for methods that know none.
    """
    found, std = solution.uncertainty, reference_std(solution, cameras)
    if found is None:
        return ()
    R = reference_pose(solution.parameters, cameras)[:3, :3]
    lengths = tuple(None if s is None else 1e3 * s for s in std[3:])
    if se3.gimbal_margin_deg(R) < NEAR_LOCK_DEG or not found.observable[:3].all():
        return (None, None, None, *lengths)
    step = np.eye(3) * _ANGLE_STEP_RAD
    ahead, behind = (np.array([se3.euler_zyx_deg(se3.exp_so3(s * r) @ R) for r in step]) for s in (1, -1))
    J = ((ahead - behind + 180) % 360 - 180).T / (2 * _ANGLE_STEP_RAD)
    angles = np.sqrt(np.diag(J @ found.covariance[:3, :3] @ J.T))
    return (*angles.tolist(), *lengths)


def written(sigma: Sigma) -> str:
    """A standard deviation for people."""
    return "held" if sigma.value is None else f"{sigma.value:.3f}"


def predicted_point_rms_m(extraction: Extraction, solution: Solution) -> float:
    """What eq. 19's square root would be if the triangulated corners' own noise were all there is, m."""
    traces = np.array([np.trace(o.points_cov, axis1=-2, axis2=-1).mean() for o in extraction.observations])
    legs = solution.residuals.legs
    return float(np.sqrt(np.mean(traces[legs].sum(axis=1)))) if len(legs) else 0.0


def board_distance_m(extraction: Extraction) -> float:
    """Median distance from camera to corners, m; 0 without observations."""
    seen = extraction.observations
    return float(np.median([np.linalg.norm(o.points_c, axis=-1).mean() for o in seen])) if seen else 0.0


def encoder_heading_rad(solution: Solution, extraction: Extraction) -> float:
    """Heading that is lost when both wheels' encoders are wrong by one step, rad."""
    wheels = solution.parameters.wheels
    tracks = extraction.wheels
    right = max((encoder_step_rad(track.right_rad) for track in tracks), default=0.0)
    left = max((encoder_step_rad(track.left_rad) for track in tracks), default=0.0)
    return (wheels.radius_right_m * right + wheels.radius_left_m * left) / wheels.separation_m


def stations_looked_at(extraction: Extraction) -> int:
    """How many stations there were, used or not."""
    return max(extraction.counts.get("stations", 0), len(extraction.observations))


def rejected_station(rejection: Rejection, extraction: Extraction) -> str:
    """The station of a rejection, after its log's index where there are several logs; "" where it has none."""
    if rejection.station < 0:
        return ""
    return f"{rejection.log}:{rejection.station}" if len(extraction.wheels) > 1 else str(rejection.station)


def rejection_counts(extraction: Extraction) -> dict[tuple[str, str], int]:
    """(stage, reason) → how many, the most frequent first."""
    counts: dict[tuple[str, str], int] = {}
    for item in extraction.rejections:
        counts[item.stage, item.reason] = counts.get((item.stage, item.reason), 0) + 1
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))


def image_coverage(pixels: FloatArray, width: int, height: int, cells: tuple[int, int] = (8, 6)) -> float:
    """Share of a coarse grid over the picture, (across, down) cells, in which any corner lies: (n, 2) → 0..1."""
    at = np.floor(pixels / [width, height] * cells).astype(int)
    inside = np.all((at >= 0) & (at < cells), axis=-1)
    return len(np.unique(at[inside], axis=0)) / (cells[0] * cells[1])


def station_names(extraction: Extraction) -> list[str]:
    """What each observation's station is called: its index in the log, after the log's where there are several."""
    several = len({o.log for o in extraction.observations}) > 1
    return [f"{o.log}:{o.station}" if several else str(o.station) for o in extraction.observations]
