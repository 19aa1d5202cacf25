"""The sentences on the expected errors in use."""

from __future__ import annotations

from collections.abc import Sequence

from mobilecal_cli.report.check import Check
from mobilecal_cli.report.parameters import std_text
from mobilecal_cli.report.wording.budget import advice, limiting_sentence
from mobilecal_cli.report.wording.words import Words

#: Extent of the motion → its name, and what to do where it is small.
MOTION = {
    "pan_range_deg": ("pan range of the head", "pan the head further left and right"),
    "tilt_range_deg": ("tilt range of the head", "tilt the head further up and down"),
    "turned_deg": ("rotation of the base", "turn the base between stops"),
    "driven_m": ("path length of the base", "drive the base further between stops"),
}


def use_words(c: Check) -> Words:
    """An expected error against its limit."""
    meaning, shares, limit = c.facts["meaning"], c.facts["shares"], f"{c.limit:g} {c.unit}"
    value = f"{std_text(c.value)} {c.unit}" if c.value else "fixed by the user"
    return Words(
        f"expected error: {meaning}",
        value,
        f"at most {limit}",
        f"The expected error (1 sigma) of the {meaning} is {value} (limit {limit}). "
        f"{limiting_sentence(shares, meaning)}",
        " ".join((advice(shares), *(_more(key, now) for key, now in c.facts["small"]))),
    )


def _more(key: str, now: float) -> str:
    more = MOTION[key][1]
    return (
        f"{more[0].upper()}{more[1:]} (now {f'{now:.1f} m' if key.endswith('_m') else f'{now:.0f} degrees'})."
    )


def use_sentence(errors: Sequence[tuple[float, str]]) -> str:
    """The expected errors that have a default limit, (value, unit) in the order of `FIGURES`, in one sentence."""
    camera_m, camera_rad, along, per_m, per_turn = (f"{std_text(value)} {unit}" for value, unit in errors)
    camera = f"{camera_m} and {camera_rad}" if any(value for value, _ in errors[:2]) else "fixed by the user"
    wheels = f"{along}, {per_m} and {per_turn} per full turn"
    if not any(value for value, _ in errors[2:]):
        wheels = "with wheels fixed by the user"
    return (
        f"Expected errors (1 sigma): camera in the base {camera}; dead reckoning {wheels}. "
        "All are within their limits."
    )


def passed(
    stations: int, point_mm: float, distance_m: float, method: str, errors: Sequence[tuple[float, str]] | None
) -> tuple[str, str]:
    """Reason and next step where a calibration passes.

    Args:
        stations: number of stations used.
        point_mm, distance_m: point error, and distance to the board.
        method: of the solution.
        errors: see `use_sentence`; None for methods that give no standard deviations.
    """
    point = (
        f"The point error over {stations} stations is {point_mm:.1f} mm, {0.1 * point_mm / distance_m:.1f} % of the "
        "distance to the board."
    )
    if errors is None:
        return (
            f"{point} The method {method} gives no standard deviations, so the expected errors in use are unknown.",
            "Calibrate with --method ml (the default) for a result that the robot can use.",
        )
    return f"{point} {use_sentence(errors)}", "Use params.yaml on the robot."
