"""What an estimate tells beside its numbers: evidence for more of them, the logs one by one, what to record next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from mobilecal_cli.model.arrays import FloatArray, freeze


@dataclass(frozen=True, slots=True)
class Evidence:
    """Whether the log supports more numbers than the nine.

    Attributes:
        group: what `--estimate` calls them.
        values: name → value and standard deviation: as estimated, or as they would be to first order.
        state: "estimated" (they are in the answer), "offered" (the log shows them, and they are not) or "hidden"
            (the log does not show them).
        chi2: twice the gain in log-likelihood over leaving them at zero, to second order.
        bic: chi2 less the Bayesian information criterion's price; above 0 the log supports them.
    """

    group: str
    values: Mapping[str, tuple[float, float]]
    state: Literal["estimated", "offered", "hidden"]
    chi2: float
    bic: float


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """The board's squares and the stereo baseline are two yardsticks; this is their ratio.

    Attributes:
        ratio: size of the squares, measured by the baseline, over their stated size.
        std: of the ratio.
        square_m, baseline_m: as stated.
        apart: whether the ratio leaves 1 by more than its sigma allows; the answer then trusts the baseline.
    """

    ratio: float
    std: float
    square_m: float
    baseline_m: float
    apart: bool


@dataclass(frozen=True, slots=True, eq=False)
class BetweenLogs:
    """What each of several logs says by itself.

    Attributes:
        shift: (L, 9) each log's own estimate less the pooled one, order and units of `NINE`; NaN where a log does not
            show a number.
        std: (L, 9) their standard deviations within the log.
        between_std: (9,) spread of the numbers from log to log beyond those; 0 where there is no sign of any.
    """

    shift: FloatArray
    std: FloatArray
    between_std: FloatArray

    def __post_init__(self) -> None:
        logs = freeze(self, shift=("L", 9))["L"]
        freeze(self, std=(logs, 9), between_std=(9,))


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """One more stop at the end of the log, and what it would bring.

    Attributes:
        turn_rad, drive_m: the base's way there: first the turn (left is positive), then the drive.
        joints: (J,) where the head's joints should stand.
        worst: the number whose standard deviation is worst now, by what a robot needs.
        std_now, std_then: its standard deviation, rad or m.
        gain: by what share the worst standard deviation shrinks, over all nine.
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
