"""Results beyond the nine parameters as table rows and sentences, for report.html and the terminal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.budget import usual_jackknife_factor
from mobilecal_cli.model import (
    NINE,
    Extraction,
    HeadChain,
    ScaleCheck,
    Solution,
    Suggestion,
)
from mobilecal_cli.report.at_work import FIGURES
from mobilecal_cli.report.numbers import std_text
from mobilecal_cli.report.units import SHOWN, value_text

#: Noise level → label and unit.
_LEVELS = {
    "pixel_px": ("corner coordinate", "px"),
    "wheel_rad_per_sqrt_rad": ("wheel rotation", "rad per √rad"),
    "encoder_rad": ("encoder reading", "rad"),
    "joint_rad": ("joint reading", "deg"),
    "floor_rad": ("floor: roll and pitch of the base at each stop", "deg"),
    "floor_m": ("floor: height of the base at each stop", "mm"),
    "stamp_s": ("image time stamp in motion", "ms"),
    "wheel_share": ("wheel rotation on a leg, in proportion to it", "%"),
}
_LEVEL_FACTORS = {"floor_rad": 180 / math.pi, "floor_m": 1e3, "stamp_s": 1e3, "wheel_share": 100.0}


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table.

    Attributes:
        name, meaning, value, std, unit: formatted.
    """

    name: str
    meaning: str
    value: str
    std: str
    unit: str


def predicted_rows(solution: Solution) -> tuple[Row, ...]:
    """Expected errors of a robot in use; in `value`, the default limit."""
    found = solution.uncertainty
    if found is None:
        return ()
    return tuple(
        Row("", f.meaning, "" if f.limit is None else f"{f.limit:g}", std_text(f.of(found.at_work)), f.unit)
        for f in FIGURES
    )


def noise_rows(solution: Solution, extraction: Extraction) -> tuple[Row, ...]:
    """Measurement noise: in `value`, how each level was obtained; none for methods that give none."""
    if solution.uncertainty is None:
        return ()
    noise, given = solution.uncertainty.noise, extraction.rig.noise.given
    moving = not all(o.at_rest for o in extraction.observations)
    rows = []
    for level, (meaning, unit) in _LEVELS.items():
        std = float(getattr(noise, level))
        source = "given" if level in given else "assumed"
        if level == "stamp_s" and not moving:
            continue
        if level in noise.estimated:
            source = f"estimated from {noise.redundancy[level]:.0f} redundant residuals"
        elif level == "encoder_rad":
            if not std:
                continue
            source = "given, or derived from the encoder step"
        if level != "joint_rad":
            rows.append(Row("", meaning, source, std_text(std * _LEVEL_FACTORS.get(level, 1.0)), unit))
            continue
        for kind, factor, kind_unit in joint_kinds(extraction.rig.chain):
            rows.append(Row("", f"{meaning}{kind}", source, std_text(std * factor), kind_unit))
    return tuple(rows)


def joint_kinds(chain: HeadChain) -> tuple[tuple[str, float, str], ...]:
    """Kinds of joints of a head: (suffix of the label, factor from units of joint noise, display unit)."""
    units = dict(zip(chain.joints, chain.joint_units, strict=True))
    both = 0 < len(chain.prismatic) < len(units)
    revolute, prismatic = (", revolute", ", prismatic") if both else ("", "")
    kinds = [(revolute, 180 / math.pi, "deg")] if len(chain.prismatic) < len(units) or not units else []
    kinds += [(prismatic, 1e3 * units[name], "mm") for name in sorted(chain.prismatic)[:1]]
    return tuple(kinds)


def jackknife_sentence(solution: Solution) -> str:
    """Comparison of the jackknife's standard deviations with those of the estimate; "" where there are none."""
    found = solution.uncertainty
    if found is None:
        return ""
    known = (found.noise_std > 0) & (found.jackknife_std > 0)
    if not known.any():
        return ""
    ratio = found.jackknife_std[known] / found.noise_std[known]
    usual = usual_jackknife_factor(len(solution.residuals.legs))
    sentence = (
        "Jackknife test: solving repeatedly, each time without the corners or the joint readings of one station or "
        f"the wheel rotations of one leg, gives {ratio.min():.2f} to {ratio.max():.2f} times the standard deviations "
        f"of the noise levels. With {len(solution.residuals.legs)} legs, factors from {1 / usual:.1f} to {usual:.1f} "
        "are usual."
    )
    widened = [
        f"{name} ({factor:.1f} times)" for name, factor in zip(NINE, found.widened, strict=True) if factor > 1
    ]
    if widened:
        sentence += (
            f" The standard deviations of {', '.join(widened)} are therefore those of the jackknife: the residuals "
            "vary more from station to station than their noise levels say."
        )
    return sentence


def scale_sentence(scale: ScaleCheck) -> str:
    """Square size and baseline as measured, if the other one is correct, and as stated."""
    squares, baseline = scale.square_m * scale.ratio, scale.baseline_m / scale.ratio
    return (
        f"With the stated baseline of {scale.baseline_m * 1e3:.2f} mm, the squares measure {squares * 1e3:.2f} mm "
        f"(stated: {scale.square_m * 1e3:.2f} mm); with the stated squares, the baseline measures "
        f"{baseline * 1e3:.2f} mm. The difference is {100 * (scale.ratio - 1):+.2f} % with a standard deviation of "
        f"{100 * scale.std:.2g} %."
    )


def log_rows(solution: Solution, extraction: Extraction) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Each recording's own estimate minus the common one, and the spread between recordings; in deg and mm."""
    between = solution.between
    if between is None:
        return ()
    factors = [SHOWN[name][1] for name in NINE]
    present = sorted({o.log for o in extraction.observations})
    rows = []
    fixed = solution.uncertainty.fixed if solution.uncertainty is not None else np.zeros(9, dtype=np.bool_)
    without = ["fixed" if by_user else "unobservable" for by_user in fixed]
    for number, shift, std, shown in zip(present, between.shift, between.std, between.shown, strict=True):
        cells = (
            f"{value_text(s * f, d * f, 3, '+')} ± {std_text(d * f)}" if ok else otherwise
            for s, d, f, ok, otherwise in zip(shift, std, factors, shown, without, strict=True)
        )
        rows.append((f"recording {number}", tuple(cells)))
    compared = between.shown.sum(axis=0) > 1
    spread = tuple(
        std_text(s * f) if ok else otherwise
        for s, f, ok, otherwise in zip(between.between_std, factors, compared, without, strict=True)
    )
    return (*rows, ("spread between recordings", spread))


def _path(suggestion: Suggestion) -> str:
    """How the base gets to a suggested stop."""
    turn, drive = math.degrees(suggestion.turn_rad), suggestion.drive_m
    parts = []
    if turn:
        parts.append(f"turn the base {'left' if turn > 0 else 'right'} by {abs(turn):.0f} degrees")
    if drive:
        parts.append(f"drive {'forward' if drive > 0 else 'back'} by {abs(drive):.1f} m")
    return ", then ".join(parts) or "do not move the base"


def suggestion_sentences(solution: Solution, extraction: Extraction) -> tuple[str, ...]:
    """What to record next, most useful first: base motion, head angles and expected standard deviation."""
    names, prismatic = extraction.rig.chain.joints, extraction.rig.chain.prismatic
    sentences = []
    for suggestion in solution.suggestions:
        unit, factor = SHOWN[suggestion.worst]
        head = ", ".join(
            f"{name} to {f'{at * 1e3:.0f} mm' if name in prismatic else f'{round(math.degrees(at))}°'}"
            for name, at in zip(names, suggestion.joints, strict=True)
        )
        now, then = suggestion.std_now * factor, suggestion.std_then * factor
        path, worst = _path(suggestion), suggestion.worst
        if _observable(solution, worst):
            gain = (
                f"the standard deviation of {worst} falls from {now:.2g} to {then:.2g} {unit}, and the least certain "
                f"parameter improves by {100 * suggestion.gain:.0f} %"
            )
        else:
            gain = f"{worst}, now unobservable, gets a standard deviation of {then:.2g} {unit}"
        sentences.append(
            f"{path[0].upper()}{path[1:]}. Set {head}, so that both cameras see the whole board, and stop. "
            f"Expected result: {gain}."
        )
    return tuple(sentences)


def _observable(solution: Solution, name: str) -> bool:
    found = solution.uncertainty
    return found is not None and bool(found.observable[NINE.index(name)])
