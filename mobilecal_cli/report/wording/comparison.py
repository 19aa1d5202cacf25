"""The sentences on differences between calibrations."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli.comparison import Difference
from mobilecal_cli.likelihood.predict import AHEAD_M
from mobilecal_cli.model import NINE

#: Significance level.
_UNLIKELY = 0.01


def effects(found: Difference) -> tuple[tuple[str, float, str], ...]:
    """What a change means for the robot: (effect, value, unit)."""
    return (
        (f"Shift of a point {AHEAD_M:g} m ahead of the camera", found.ray_m * 1e3, "mm"),
        ("Dead reckoning: distance, driving straight", found.along_m_per_m * 1e3, "mm per m"),
        ("Dead reckoning: heading, driving straight", math.degrees(found.heading_rad_per_m), "deg per m"),
        ("Heading per full turn", math.degrees(found.heading_rad_per_turn), "deg"),
    )


def changed(found: Difference) -> bool | None:
    """Whether the robot has changed, or one of the calibrations is wrong; None where that is unknown."""
    return None if found.chance is None else found.chance < _UNLIKELY


def headline(found: Difference, first: str, second: str) -> str:
    """Whether the second calibration differs from the first, with the largest change in sigmas."""
    change = changed(found)
    if change is None:
        return (
            f"Unknown: {first} and {second} have no parameter that both determine with a standard deviation."
        )
    sigmas = np.where(found.known, np.abs(found.sigmas), 0.0)
    worst = int(np.argmax(sigmas))
    said = "Changed" if change else "Unchanged"
    note = f"; no conclusion about {hidden}" if (hidden := _unobservable(found)) else ""
    return f"{said}: from {first} to {second}, at most {sigmas[worst]:.1f} sigma ({NINE[worst]}){note}."


def _unobservable(found: Difference) -> str:
    return ", ".join(name for name, hides in zip(NINE, found.unobservable, strict=True) if hides)


def conclusion(found: Difference) -> str:
    """Whether the robot has changed, and how certain that is."""
    names = _unobservable(found)
    blind = f"No conclusion about {names}: at least one calibration does not determine it." if names else ""
    if found.chance is None:
        return blind or "No significance test: at least one calibration has no standard deviations."
    verdict = (
        "The robot has changed, or one of the two calibrations is wrong."
        if changed(found)
        else f"The change{' of these' if blind else ''} is not significant."
    )
    note = " The calibrations share a recording, so this test is weak." if found.shared else ""
    if blind:
        note += f" {blind}"
    return (
        f"Chi-squared {found.chi2:.1f} for {int(found.known.sum())} parameters; probability by chance "
        f"{_percent(found.chance)}. {verdict}{note}"
    )


def _percent(probability: float) -> str:
    share = 100 * probability
    return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"


def constancy(chance: float) -> str:
    """Whether a parameter changed over several calibrations, by the probability of such a spread by chance."""
    if not math.isfinite(chance):
        return "unknown in all but one calibration"
    return f"{'changed' if chance < _UNLIKELY else 'unchanged'} (probability by chance {_percent(chance)})"
