"""Expected errors when the calibration is used, and the criteria on them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mobilecal_cli.model import AtWork, Solution
from mobilecal_cli.report.budget import shares_of
from mobilecal_cli.report.check import LEAST_MOTION, Check
from mobilecal_cli.report.metrics import FIGURES, Figure
from mobilecal_cli.report.values import Outcome
from mobilecal_cli.report.wording.budget import advice, limiting_sentence


def default_errors(expected: AtWork) -> list[tuple[float, str]]:
    """(value, unit) of the expected errors that have a default limit."""
    return [(figure.of(expected), figure.unit) for figure in FIGURES if figure.limit is not None]


#: Names of the gates that the verdict on use judges.
USE_GATES = frozenset(figure.name for figure in FIGURES)


@dataclass(frozen=True, slots=True)
class Use:
    """An expected error against its limit.

    Attributes:
        figure: which.
        value, limit: in its unit.
    """

    figure: Figure
    value: float
    limit: float

    @property
    def within(self) -> bool:
        """Whether the error is within its limit; not if it is no number."""
        return self.value <= self.limit

    @property
    def share(self) -> float:
        """Error over limit."""
        return self.value / self.limit if self.limit > 0 else math.inf if self.value > 0 else 0.0


def uses(solution: Solution, limits: Mapping[str, float]) -> tuple[Use, ...]:
    """All expected errors that have a limit; none for methods that give no standard deviations.

    Args:
        solution: the solution.
        limits: gate → limit, replacing the default.
    """
    found = solution.uncertainty
    if found is None:
        return ()
    pairs = [(figure, limits.get(figure.name, figure.limit)) for figure in FIGURES]
    return tuple(Use(f, f.of(found.at_work), limit) for f, limit in pairs if limit is not None)


def least_certain(solution: Solution, limits: Mapping[str, float]) -> Use | None:
    """The expected error that is largest in relation to its limit; None where all are zero or unknown."""
    worst = max(uses(solution, limits), key=lambda use: use.share, default=None)
    return worst if worst is not None and worst.share > 0 else None


def use_checks(solution: Solution, limits: Mapping[str, float]) -> Iterator[Check]:
    """Whether each expected error is within its limit; the least certain first."""
    for use in sorted(uses(solution, limits), key=lambda use: -use.share):
        figure = use.figure
        facts = {
            "meaning": figure.meaning,
            "shares": shares_of(solution, figure.field),
            "small": _small_motion(solution, figure),
        }
        outcome: Outcome = "pass" if use.within else "not_enough"
        yield Check(figure.name, use.value, use.limit, outcome, facts)


def _small_motion(solution: Solution, figure: Figure) -> Sequence[tuple[str, float]]:
    """(extent, value) of motion of which the recording has little, and which this figure depends on."""
    of_camera, of_point = figure.field in {"camera_m", "camera_rad"}, figure.field == "point_m"
    fixed = [False] * 9 if solution.uncertainty is None else solution.uncertainty.fixed.tolist()
    head = (of_camera or of_point) and not all(fixed[:6])
    base = not of_camera and not all(fixed[6:])
    motion = solution.motion
    return [
        (key, motion[key])
        for (key, least), wanted in zip(LEAST_MOTION.items(), (head, head, base, base), strict=True)
        if wanted and motion.get(key, least) < least
    ]


def recommendation(solution: Solution, limits: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """What limits the least certain expected error, and what to do about it; empty where nothing is known."""
    worst = least_certain(solution, limits or {})
    if worst is None:
        return ()
    shares = shares_of(solution, worst.figure.field)
    return limiting_sentence(shares, worst.figure.meaning), advice(shares)
