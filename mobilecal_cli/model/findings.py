"""Results beyond the nine parameters: model comparison, scale check, single recordings, suggestions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, freeze


@dataclass(frozen=True, slots=True)
class Evidence:
    """Whether the data support a group of additional parameters.

    Attributes:
        group: its name for `--estimate`.
        values: parameter → value and standard deviation: as estimated, or to first order if not estimated.
        state: "estimated", "offered" (observable but not estimated) or "unobservable".
        chi2: twice the gain in log-likelihood compared with zero values, to second order.
        bic: chi2 minus the penalty of the Bayesian information criterion; above 0 the data support the group.
    """

    group: str
    values: Mapping[str, tuple[float, float]]
    state: Literal["estimated", "offered", "unobservable"]
    chi2: float
    bic: float


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Consistency of the two references for scale: the stated squares and the stereo baseline.

    Attributes:
        ratio: size of the squares as measured with the baseline, over their stated size.
        std: standard deviation of the ratio.
        square_m, baseline_m: as stated.
        apart: the ratio differs from 1 significantly; the solution then uses the baseline for scale.
    """

    ratio: float
    std: float
    square_m: float
    baseline_m: float
    apart: bool


@dataclass(frozen=True, slots=True, eq=False)
class BetweenLogs:
    """Estimates from each of several recordings alone.

    Attributes:
        shift: (L, 9) each recording's own estimate minus the common one, order and units of `NINE`; 0 where a
            parameter is unobservable in a recording.
        std: (L, 9) their standard deviations; 0 where a parameter is unobservable.
        shown: (L, 9) whether the parameter is observable in the recording.
        between_std: (9,) additional spread between the recordings; 0 where none is significant.
    """

    shift: FloatArray
    std: FloatArray
    shown: BoolArray
    between_std: FloatArray

    def __post_init__(self) -> None:
        logs = freeze(self, shift=("L", 9))["L"]
        freeze(self, std=(logs, 9), between_std=(9,))
        freeze(self, np.bool_, shown=(logs, 9))


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """An additional stop at the end of the recording, and the expected improvement.

    Attributes:
        turn_rad, drive_m: motion of the base: first the turn (left is positive), then the drive.
        joints: (J,) head joint values, rad or m.
        worst: the least certain parameter relative to what a robot needs.
        std_now, std_then: its standard deviation without and with the stop, rad or m.
        gain: relative decrease of the largest standard deviation over all nine.
    """

    turn_rad: float
    drive_m: float
    joints: FloatArray
    worst: str
    std_now: float
    std_then: float
    gain: float

    def __post_init__(self) -> None:
        freeze(self, joints=("J",))


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A mistake in the robot's description that explains why a recording does not fit.

    Attributes:
        cause: what is wrong, as the end of a sentence.
        cure: what to do, as a command.
        error_share: point error over the distance to the board as the recording stands; None if there is no solution.
        corrected_share: the same without the mistake; None if it was not computed.
    """

    cause: str
    cure: str
    error_share: float | None
    corrected_share: float | None
