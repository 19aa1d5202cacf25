"""What the estimate tells beside the nine numbers, in rows and sentences: for report.html and the terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.predict import predicted
from mobilecal_cli.likelihood.shared import EXTRAS, INDEX
from mobilecal_cli.model import NINE, Evidence, Extraction, ScaleCheck, Solution, Suggestion
from mobilecal_cli.report.units import SHOWN

_SHOWN_UNITS = {
    "s": ("ms", 1e3),
    "rad": ("deg", 180 / math.pi),
    "m": ("mm", 1e3),
    "px": ("px", 1.0),
    "1": ("%", 100.0),
}

LEVEL_NAMES = {
    "pixel_px": "corners",
    "wheel_rad_per_sqrt_rad": "wheels",
    "encoder_rad": "encoders",
    "joint_rad": "joints",
}
_JACKKNIFE_SCATTER = (
    3.6  # over the root of the legs: 19 of 20 simulated logs of 12 and of 40 stations stay within
)


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a table.

    Attributes:
        name, meaning, value, std, unit: ready to be shown.
    """

    name: str
    meaning: str
    value: str
    std: str
    unit: str


def predicted_rows(solution: Solution) -> tuple[Row, ...]:
    """What the standard deviations mean for a robot at work."""
    found = solution.uncertainty
    if found is None:
        return ()
    p = predicted(solution.parameters, found.covariance)
    return tuple(
        Row("", meaning, "", f"{value:.3g}", unit)
        for meaning, value, unit in (
            ("camera's place on the head", p.camera_m * 1e3, "mm"),
            ("camera's direction", math.degrees(p.camera_rad), "deg"),
            ("a point that the camera sees 2 m ahead", p.point_m * 1e3, "mm"),
            ("dead reckoning straight on: distance", p.along_m_per_m * 1e3, "mm per m"),
            (
                "dead reckoning straight on: sideways, after the first metre",
                p.sideways_m_per_m * 1e3,
                "mm per m",
            ),
            ("dead reckoning straight on: heading", math.degrees(p.heading_rad_per_m), "deg per m"),
            ("dead reckoning on the spot: heading", math.degrees(p.heading_rad_per_turn), "deg per turn"),
        )
    )


def jackknife_sentence(solution: Solution) -> str:
    """How far the two kinds of standard deviation agree; "" where there are none."""
    found = solution.uncertainty
    if found is None:
        return ""
    known = (found.std > 0) & (found.jackknife_std > 0)
    if not known.any():
        return ""
    ratio = found.jackknife_std[known] / found.std[known]
    usual = 1 + _JACKKNIFE_SCATTER / math.sqrt(max(len(solution.residuals.legs), 1))
    return (
        "Second opinion: leaving out every station's pictures, its joint readings and every leg's wheels in turn "
        f"(jackknife) gives {ratio.min():.2f} to {ratio.max():.2f} times these standard deviations; with so many legs, "
        f"a factor of {usual:.1f} either way is usual."
    )


def extra_rows(solution: Solution, extraction: Extraction) -> tuple[Row, ...]:
    """What was estimated beside the nine."""
    return tuple(
        _square(value, std, extraction)
        if name == "square_scale" and extraction.board.square_m is None
        else _extra(name, value, std)
        for name, (value, std) in solution.extras.items()
    )


def _square(value: float, std: float, extraction: Extraction) -> Row:
    """The squares' size where none is stated: the scale counts from the median of the stations."""
    median_mm = 1e3 * float(np.median([o.square_m for o in extraction.observations]))
    meaning = "side of the board's squares, by the stereo pair"
    return Row("square", meaning, f"{median_mm * (1 + value):.3f}", f"{median_mm * std:.2g}", "mm")


def _extra(name: str, value: float, std: float) -> Row:
    extra = EXTRAS[INDEX[name]]
    unit, factor = _SHOWN_UNITS[extra.unit]
    shown = f"{std * factor:.2g}" if math.isfinite(std) else "not shown"
    return Row(name, extra.meaning, f"{value * factor:.4g}", shown, unit)


def evidence_rows(
    solution: Solution, extraction: Extraction
) -> tuple[tuple[Evidence, tuple[Row, ...], str], ...]:
    """Every group of extras: its numbers and what the log says of them."""
    rows = []
    for found in solution.evidence:
        if found.group == "square_scale" and extraction.board.square_m is None:
            continue  # its zero is no stated size, but the first guess
        members = tuple(_extra(name, value, std) for name, (value, std) in found.values.items())
        rows.append((found, members, _says(found)))
    return tuple(rows)


def _says(found: Evidence) -> str:
    if found.state == "hidden":
        return "this recording does not show it"
    supported = found.bic > 0
    if found.state == "estimated":
        return (
            "estimated, and supported" if supported else "estimated, but not needed: it may as well be zero"
        )
    return f"supported: add --estimate {found.group}" if supported else "not needed"


def scale_sentence(scale: ScaleCheck) -> str:
    """Both readings of squares and baseline."""
    squares, baseline = scale.square_m * scale.ratio, scale.baseline_m / scale.ratio
    return (
        f"The board's squares are {squares * 1e3:.2f} mm (stated: {scale.square_m * 1e3:.2f} mm), or the baseline is "
        f"{baseline * 1e3:.2f} mm (stated: {scale.baseline_m * 1e3:.2f} mm): {100 * (scale.ratio - 1):+.2f} %, "
        f"standard deviation {100 * scale.std:.2g} %."
    )


def log_rows(solution: Solution, extraction: Extraction) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Each log's own estimate less the pooled one, and the spread between logs; in degrees and mm."""
    between = solution.between
    if between is None:
        return ()
    factors = [SHOWN[name][1] for name in NINE]
    present = sorted({o.log for o in extraction.observations})
    rows = []
    for number, shift, std in zip(present, between.shift, between.std, strict=True):
        cells = (
            f"{s * f:+.3f} ± {d * f:.3f}" if np.isfinite(s) else "not shown"
            for s, d, f in zip(shift, std, factors, strict=True)
        )
        rows.append((f"log {number}", tuple(cells)))
    spread = tuple(f"{s * f:.3f}" for s, f in zip(between.between_std, factors, strict=True))
    return (*rows, ("spread between logs", spread))


def _way(suggestion: Suggestion) -> str:
    turn, drive = math.degrees(suggestion.turn_rad), suggestion.drive_m
    parts = []
    if turn:
        parts.append(f"turn the base {'left' if turn > 0 else 'right'} by {abs(turn):.0f} degrees")
    if drive:
        parts.append(f"drive {'forward' if drive > 0 else 'back'} by {abs(drive):.1f} m")
    return ", then ".join(parts) or "leave the base where it is"


def suggestion_sentences(solution: Solution, extraction: Extraction) -> tuple[str, ...]:
    """What to record next, the best first: the way, the head, and what it would bring."""
    names = extraction.rig.chain.joints
    sentences = []
    for suggestion in solution.suggestions:
        unit, factor = SHOWN[suggestion.worst]
        head = ", ".join(
            f"{name} {round(math.degrees(at))}°" for name, at in zip(names, suggestion.joints, strict=True)
        )
        now, then = suggestion.std_now * factor, suggestion.std_then * factor
        way, worst = _way(suggestion), suggestion.worst
        if _seen(solution, worst):
            brings = (
                f"{worst} would be known to {then:.2g} {unit} instead of {now:.2g} (one standard deviation), and "
                f"the worst of all nine shrinks by {100 * suggestion.gain:.0f} %"
            )
        else:
            brings = f"{worst}, which this recording does not show, would be known to {then:.2g} {unit}"
        sentences.append(
            f"{way[0].upper()}{way[1:]}; move the head ({head}) so that both cameras see the whole board, and stop: "
            f"{brings}."
        )
    return tuple(sentences)


def _seen(solution: Solution, name: str) -> bool:
    found = solution.uncertainty
    return found is not None and bool(found.observable[NINE.index(name)])
