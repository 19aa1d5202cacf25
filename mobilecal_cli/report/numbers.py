"""Numbers of the report: the nine parameters with their names and units, and what follows from a solution and its data.

A value is shown with the digits that its standard deviation justifies.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import head_eye_words
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, WHEEL_WORDS
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import FACTORS, Rig, WheelGeometry
from mobilecal_cli.model.solution import Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.formats import JsonValue, Table

_MOST_DECIMALS = 6  # of rad and m: one digit of the smallest standard deviations
_UNCERTAIN_DIGITS = 5  # decimals where no standard deviation is known: 0.01 mm
_MOST_REASONS = 3  # why stations were rejected, in one line
DEG = 180 / math.pi  # degrees per rad
#: Cells across and down an image, in which coverage and projection errors are shown.
CELLS = (8, 6)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the nine parameters.

    Attributes:
        name: as in params.yaml.
        label: in a summary.
        unit: "rad" or "m"; "" for a factor of odometry.
        shown_unit, factor: unit for people, and how many of it one unit of the value in the code (rad or m) is.
    """

    name: str
    label: str
    unit: str
    shown_unit: str
    factor: float

    @property
    def gate(self) -> str:
        """Name of the gate on its standard deviation; not of a factor of odometry."""
        return f"std.{'wheels' if self.name in NINE[6:] else 'head_eye'}.{self.name}_{self.unit}"

    @property
    def per_unit(self) -> float:
        """How many of `unit` a value of one in the code is: rad and m stay, of assumed wheels follow factors."""
        return 1.0 if self.unit else self.factor


_ANGLE, _LENGTH = ("rad", "deg", DEG), ("m", "mm", 1e3)
PARAMETERS = (
    *(Parameter(f"r_{axis}", f"rotation {axis}", *_ANGLE) for axis in "xyz"),
    *(Parameter(f"t_{axis}", f"translation {axis}", *_LENGTH) for axis in "xyz"),
    *(Parameter(name, label, *_LENGTH) for name, label in zip(NINE[6:], WHEEL_WORDS, strict=True)),
)


def parameters_of(assumed: WheelGeometry | None) -> tuple[Parameter, ...]:
    """The nine parameters; with assumed wheels (odometry alone), the last three are factors of these."""
    if assumed is None:
        return PARAMETERS
    return (
        *PARAMETERS[:6],
        *(
            Parameter(name, name.replace("_", " "), "", "", factor=1 / size)
            for name, size in zip(FACTORS, assumed.vector.tolist(), strict=False)
        ),
    )


def value_text(value: float, std: float | None, otherwise: int, sign: str = "") -> str:
    """A value with as many decimals as its standard deviation shows, `otherwise` where that is None or not positive.

    The sign "+" writes the sign of positive values too.
    """
    return f"{value:{sign}.{otherwise if std is None else decimals_of(std, otherwise)}f}"


def std_text(std: float) -> str:
    """A standard deviation or an error with two significant digits, never rounded to zero."""
    return f"{std:.1e}" if 0 < std < 10.0**-_MOST_DECIMALS else f"{std:.{decimals_of(std)}f}"


_LEAST_PROBABILITY = 1e-6  # worth a digit


def percent_text(share: float) -> str:
    """A probability in percent with two digits, or that it is below the smallest one worth a digit."""
    if share < _LEAST_PROBABILITY:
        return f"below {100 * _LEAST_PROBABILITY:g} %"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def decimals_of(std: float, otherwise: int = 3) -> int:
    """Decimals for two significant digits of a standard deviation; `otherwise` where it is zero or not finite."""
    if not (math.isfinite(std) and std > 0):
        return otherwise
    exponent = int(f"{std:.1e}".partition("e")[2])
    return min(max(1 - exponent, 0), _MOST_DECIMALS)


class NumberData(JsonValue):
    """One number of the result, as every output shows it.

    The value of a rotation is a component of the rotation vector from the camera to the head, and its standard
    deviation that of a small rotation about the head's axis, as in params.yaml.

    Attributes:
        name: as in params.yaml.
        label: for people.
        unit: of value and std, as in params.yaml.
        value, std: None where it has no standard deviation.
        state: "" for an estimated number, otherwise "fixed", "not determined", "from the robot description" or, where
            the user stated a prior of what no motion shows, "from --prior".
        value_text, std_text: with two digits of the standard deviation.
    """

    name: str
    label: str
    unit: str
    value: float
    std: float | None
    state: str
    value_text: str
    std_text: str


_UNKNOWN = "not determined"


def numbers_of(solution: Solution, rig: Rig) -> tuple[NumberData, ...]:
    """Head-eye transform of the reference camera, and wheels or factors: the numbers that every output shows."""
    T, uncertainty = solution.T_h_reference, solution.uncertainty
    values = [*se3.log_so3(T[:3, :3]), *T[:3, 3], *solution.parameters.wheels.vector]
    stds = reference_std(solution)
    states = [""] * len(PARAMETERS)
    if uncertainty is not None:
        for k, std in enumerate(stds):
            states[k] = "fixed" if std is None else "" if uncertainty.observable[k] else _UNKNOWN
            if uncertainty.described[k]:
                states[k] = "from --prior" if uncertainty.with_prior[k] else "from the robot description"
    rows = [(p.name, p.label, p.unit, float(v), s) for p, v, s in zip(PARAMETERS, values, stds, strict=True)]
    factors = odometry_factors(rig, solution).items()
    if factors:  # the last two follow from the others, and may be known where one of these is not
        rows[6:] = [(name, name.replace("_", " "), "", value, std) for name, (value, std) in factors]
        unknown = [
            row[4] or 0.0 for row, state in zip(rows[6:], states[6:], strict=False) if state == _UNKNOWN
        ]
        for *_, std in rows[9:]:
            known = std is None or std < min(unknown, default=math.inf) / 2
            states.append(_UNKNOWN if not known else "fixed" if std == 0 else "")
    return tuple(
        NumberData(
            name=name,
            label=label,
            unit=unit,
            value=value,
            std=std,
            state=states[k],
            value_text=value_text(value, std, _UNCERTAIN_DIGITS),
            std_text="" if std is None else std_text(std),
        )
        for k, (name, label, unit, value, std) in enumerate(rows)
    )


def numbers_table(numbers: Sequence[NumberData]) -> Table:
    """Label, value, standard deviation, unit and state of each number."""
    rows = [
        (n.label, n.value_text, f"± {n.std_text}" if n.std_text else "", n.unit, n.state) for n in numbers
    ]
    return Table.of(("parameter", "strong:value", "number:1 sigma", "unit", ""), rows)


def stations_text(extraction: Extraction) -> str:
    """Stations used and searched, with how many were rejected and why: "26 of 40 (12 blurred, 2 no board)"."""
    used, searched = len(extraction.observations), stations_looked_at(extraction)
    last = {(r.log, r.station): r.reason for r in extraction.rejections if r.station >= 0}
    at = {(o.log, o.station) for o in extraction.observations}
    reasons = Counter(reason for key, reason in last.items() if key not in at).most_common(_MOST_REASONS)
    said = ", ".join(f"{count} {visible(reason)}" for reason, count in reasons)
    return f"{used} of {searched}{f' ({said})' if said and used < searched else ''}"


def odometry_factors(rig: Rig, solution: Solution) -> dict[str, tuple[float, float | None]]:
    """Name → value and standard deviation of the factors of odometry; empty for robots with wheels."""
    assumed, uncertainty = rig.sources.assumed_odometry, solution.uncertainty
    if assumed is None:
        return {}
    wheels, std = solution.parameters.wheels, dict[str, float]()
    if uncertainty is not None:
        std = assumed.factors_std(wheels, uncertainty.reference_covariance[6:, 6:])
    return {name: (value, std.get(name)) for name, value in assumed.factors(wheels).items()}


def rotation_std_deg(solution: Solution) -> tuple[FloatArray | None, FloatArray | None]:
    """1 sigma of the reference camera's rotation vector, (3,), and of its Euler angles x, y, z, (3,), first order.

    None if any part of the rotation is fixed by the user; the second also near gimbal lock. The covariance is that of a
    small rotation r about the head's axes: `R_true = exp(r) R`.
    """
    R, uncertainty = solution.T_h_reference[:3, :3], solution.uncertainty
    if uncertainty is None or None in reference_std(solution)[:3]:
        return None, None
    C = uncertainty.reference_covariance[:3, :3]
    J = np.linalg.inv(se3.left_jacobian_so3(se3.log_so3(R)))
    vector_std = np.degrees(np.sqrt(np.diag(J @ C @ J.T)))
    if se3.gimbal_margin_deg(R) < se3.NEAR_LOCK_DEG:
        return vector_std, None
    step_rad = 1e-5
    ahead, behind = (
        np.array([se3.euler_zyx_deg(se3.exp_so3(r) @ R) for r in sign * step_rad * np.eye(3)])
        for sign in (1, -1)
    )
    J = ((ahead - behind + 180) % 360 - 180).T / (2 * step_rad)
    return vector_std, np.sqrt(np.diag(J @ C @ J.T))


def reference_std(solution: Solution) -> tuple[float | None, ...]:
    """Nine standard deviations for the reference camera, rad and m; None where the user fixed a parameter.

    All are None for methods that give none. With the left camera fixed, the pose of a right reference camera varies
    with the estimated stereo pair.
    """
    uncertainty = solution.uncertainty
    if uncertainty is None:
        return (None,) * len(NINE)
    std = np.sqrt(np.diag(uncertainty.reference_covariance))
    return tuple(
        None if fixed and s == 0 else float(s) for s, fixed in zip(std, uncertainty.fixed, strict=True)
    )


def stations_looked_at(extraction: Extraction) -> int:
    """Number of stations found, whether used or rejected."""
    return max(extraction.counts.get("stations", 0), len(extraction.observations))


def rejection_counts(extraction: Extraction) -> dict[tuple[str, str], int]:
    """Number of rejections for each (stage, reason), most frequent first."""
    counts = Counter((item.stage, item.reason) for item in extraction.rejections)
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))


def image_coverage(extraction: Extraction, k: int) -> float:
    """Share of the cells of a camera's images that contain a corner, 0 to 1."""
    camera = extraction.rig.cameras.each[k]
    pixels = np.concatenate([o.views[k].pixels[o.views[k].seen] for o in extraction.observations])
    at = np.floor(pixels / [camera.width, camera.height] * CELLS).astype(int)
    inside = np.all((at >= 0) & (at < CELLS), axis=-1)
    return len(np.unique(at[inside], axis=0)) / math.prod(CELLS)


def plain_names(names: Sequence[str], extraction: Extraction) -> str:
    """Some of the nine parameters in plain words, with the verb: "the camera's height is"."""
    joints = np.stack([o.joints for o in extraction.observations])
    parts = head_eye_words(names, extraction.rig.chain, joints)
    wheels = zip(NINE[6:], parameters_of(extraction.rig.sources.assumed_wheels)[6:], strict=True)
    parts += [f"the {parameter.label}" for name, parameter in wheels if name in names]
    said = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"{said} {'is' if len(parts) == 1 else 'are'}"


def station_names(extraction: Extraction) -> list[str]:
    """Name of each observation's station."""
    return [extraction.station_name(o.log, o.station) for o in extraction.observations]
