"""Expected errors when the calibration is used: their names, units and limits, and the criteria on them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from mobilecal_cli.model import AtWork, Solution
from mobilecal_cli.report.budget import advice, limiting_sentence
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, Outcome
from mobilecal_cli.report.numbers import std_text

# With less head motion, a parameter depends on a difference about as small as the noise.
MIN_PAN_DEG, MIN_TILT_DEG = 10.0, 5.0


@dataclass(frozen=True, slots=True)
class Figure:
    """One expected error.

    Attributes:
        field: of `AtWork`.
        gate: name for `--gate` and `gates:`.
        meaning: label.
        unit: for people.
        factor: how many of it one unit of the field is.
        limit: default limit in this unit; None for no limit.
    """

    field: str
    gate: str
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
#: Names of the gates that the verdict on use judges.
USE_GATES = frozenset(figure.gate for figure in FIGURES)


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
    pairs = [(figure, limits.get(figure.gate, figure.limit)) for figure in FIGURES]
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
            "limiting": limiting_sentence(solution, figure.field, figure.meaning),
            "advice": " ".join((advice(solution, figure.field), *_hints(solution, figure))),
        }
        outcome: Outcome = "good" if use.within else "short"
        yield Check(f"use.{figure.field}", use.value, use.limit, figure.unit, outcome, facts=facts)


def _hints(solution: Solution, figure: Figure) -> Sequence[str]:
    """Motion of which the recording has little, and which this figure depends on."""
    head, base = (
        figure.field in {"camera_m", "camera_rad", "point_m"},
        figure.field not in {"camera_m", "camera_rad"},
    )
    found = solution.uncertainty
    fixed = found.fixed if found is not None else [False] * 9
    head, base = head and not all(fixed[:6]), base and not all(fixed[6:])
    wanted = (
        (head, "pan_range_deg", MIN_PAN_DEG, "Pan the head further left and right (now {:.0f} degrees)."),
        (head, "tilt_range_deg", MIN_TILT_DEG, "Tilt the head further up and down (now {:.0f} degrees)."),
        (base, "turned_deg", MIN_TURNED_DEG, "Turn the base between stops (now {:.0f} degrees)."),
        (base, "driven_m", MIN_DRIVEN_M, "Drive the base further between stops (now {:.1f} m)."),
    )
    motion = solution.motion
    return [
        words.format(motion[key]) for on, key, least, words in wanted if on and motion.get(key, least) < least
    ]


def use_sentence(solution: Solution) -> str:
    """The expected errors that have a default limit, in one sentence; "" for methods that give none."""
    found = solution.uncertainty
    if found is None:
        return ""
    values = [(figure.of(found.at_work), figure.unit) for figure in FIGURES if figure.limit is not None]
    camera_m, camera_rad, along, per_m, per_turn = (f"{std_text(value)} {unit}" for value, unit in values)
    camera = f"{camera_m} and {camera_rad}" if any(value for value, _ in values[:2]) else "fixed by the user"
    wheels = f"{along}, {per_m} and {per_turn} per full turn"
    if not any(value for value, _ in values[2:]):
        wheels = "with wheels fixed by the user"
    return (
        f"Expected errors (1 sigma): camera in the base {camera}; dead reckoning {wheels}. "
        "All are within their limits."
    )


def recommendation(solution: Solution, limits: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """What limits the least certain expected error, and what to do about it; empty where nothing is known."""
    worst = least_certain(solution, limits or {})
    if worst is None:
        return ()
    field = worst.figure.field
    return limiting_sentence(solution, field, worst.figure.meaning), advice(solution, field)
