"""Stated values that the data contradict, in words: what is wrong, against what, and its cure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import Evidence, Extraction, Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check, Outcome
from mobilecal_cli.report.numbers import std_text
from mobilecal_cli.report.units import value_text

#: Evidence beyond this is a contradiction (the solver's own limit); the answer depends on it beyond the other.
CONTRADICTION_SIGMAS, SHIFT_SIGMAS = 4.0, 2.0
_NAMED_SIGMAS = 2.0  # further constants of a group are named if they are so far off
_SCALES = frozenset({"square_size", "baseline_length"})


@dataclass(frozen=True, slots=True)
class _Words:
    """What is said about one kind of constants.

    Attributes:
        against: the stated value, after "from".
        cure: in whole sentences.
    """

    against: str
    cure: str


_CAMERA = _Words(
    "camera_info",
    "Check that camera_info belongs to these images (resolution, crop). Calibrate the camera again, or use the "
    "exported camera_info.",
)
_PAIR = _Words("camera_info", "Recalibrate the stereo pair, or use the exported camera_info.")
_HEAD = _Words("the URDF", "Correct the URDF, or use the exported URDF.")
_BY_KIND = {
    "clock": _Words("equal clocks", "Synchronize the clocks (NTP or PTP) and record again."),
    "focal_length": _CAMERA,
    "principal_point": _CAMERA,
    "distortion": _CAMERA,
    "stereo_rotation": _PAIR,
    "baseline_direction": _PAIR,
    "baseline_length": _PAIR,
    "square_size": _Words(
        "the stated size",
        "Measure ten squares with a ruler, and correct board.square_m in rig.yaml.",
    ),
    "square_aspect": _Words(
        "square", "Print the board again without scaling, and measure it in both directions."
    ),
    "board_bend": _Words("a flat board", "Mount the board on a flat plate and record again."),
    "joint_zero": _HEAD,
    "joint_scale": _Words(
        "the reading", "Check the gear ratio or the encoder counts of this joint, or use the exported URDF."
    ),
    "joint_axis": _HEAD,
    "joint_position": _HEAD,
    "backlash": _Words("no backlash", "Repair the joint, or approach each head pose from the same side."),
}
_SCALE_CURE = (
    "The recording cannot tell which of the two is wrong. Measure ten squares with a ruler. If they are as stated, "
    "recalibrate the stereo pair."
)


def part_text(found: Evidence) -> str:
    """The part of the robot, capitalized; head joints are named as joints."""
    if found.kind.startswith(("joint", "backlash")):
        return f"Joint {visible(found.part)}"
    if found.kind == "clock":
        return f"Clock of the {visible(found.part)}"
    return f"{found.part[0].upper()}{found.part[1:]}"


def contradiction_sentences(found: Evidence, solution: Solution) -> tuple[str, str]:
    """What the data contradict and by how much, and the cure."""
    if found.kind in _SCALES and solution.scale is not None:
        scale = solution.scale
        off = (
            f"{value_text(abs(100 * (scale.ratio - 1)), 100 * scale.std, 2)} ± {std_text(100 * scale.std)} %"
        )
        return (
            f"The stated squares and the stereo baseline disagree by {off}: with the stated baseline of "
            f"{scale.baseline_m * 1e3:.2f} mm, the squares measure {scale.square_m * scale.ratio * 1e3:.2f} mm "
            f"(stated: {scale.square_m * 1e3:.2f} mm).",
            _SCALE_CURE,
        )
    words = _BY_KIND[found.kind]
    shown = (
        " and ".join(_difference(found, name, solution) for name in _worst(found))
    ) or "the stated values"
    return f"{part_text(found)}: {shown} from {words.against} ({_prior(found)}).", words.cure


def _worst(found: Evidence) -> tuple[str, ...]:
    """The constants that are off, worst first."""
    off = {
        name: abs(value) / math.hypot(std, found.priors[name])
        for name, (value, std) in found.values.items()
        if math.isfinite(std)
    }
    ranked = sorted(off, key=lambda name: -off[name])
    return tuple(ranked[:1] + [name for name in ranked[1:] if off[name] > _NAMED_SIGMAS])


def _difference(found: Evidence, name: str, solution: Solution) -> str:
    kind, (value, std) = nuisance.kind(found.kind), found.values[name]
    constant = solution.constants.get(name)
    meaning = constant.meaning if constant is not None else name
    shown = value_text(value * kind.shown, std * kind.shown, 3, "+")
    return f"{meaning} differs by {shown} ± {std_text(std * kind.shown)} {kind.shown_unit}"


def _prior(found: Evidence) -> str:
    kind = nuisance.kind(found.kind)
    priors = sorted({std_text(prior * kind.shown) for prior in found.priors.values()})
    return f"prior {' and '.join(priors)} {kind.shown_unit}"


def contradiction_checks(solution: Solution) -> Iterator[Check]:
    """Whether the data contradict the robot description: each contradiction, or the largest evidence."""
    if solution.uncertainty is None:
        return
    scale_done = False
    for found in solution.contradictions:
        is_scale = found.kind in _SCALES and solution.scale is not None
        if is_scale and scale_done:
            continue
        scale_done |= is_scale
        outcome: Outcome = "bad" if found.shift_sigmas > SHIFT_SIGMAS else "look"
        what, cure = contradiction_sentences(found, solution)
        yield Check(
            f"contradiction.{found.kind}.{found.part}",
            found.sigmas,
            CONTRADICTION_SIGMAS,
            "sigma",
            outcome,
            facts={
                "part": found.part,
                "meaning": nuisance.kind(found.kind).meaning,
                "shift_sigmas": found.shift_sigmas,
                "what": what,
                "cure": cure,
            },
        )
    if not solution.contradictions:
        most = max((found.sigmas for found in solution.evidence), default=0.0)
        yield Check("description", most, CONTRADICTION_SIGMAS, "sigma", "good")


@dataclass(frozen=True, slots=True)
class ConstantRow:
    """A row of the table of constants; all formatted.

    Attributes:
        name, meaning: of the constant.
        value, std, prior, unit: in the unit of its kind; prior is that of the stated value.
        level: "wrong" for constants of a contradiction, "off" beyond two priors, otherwise "".
    """

    name: str
    meaning: str
    value: str
    std: str
    prior: str
    unit: str
    level: str


def constant_groups(
    solution: Solution, extraction: Extraction
) -> tuple[tuple[str, tuple[ConstantRow, ...]], ...]:
    """All constants by part of the robot: (part, rows); those that are far off first."""
    stated = {
        name: prior for found in reversed(solution.contradictions) for name, prior in found.priors.items()
    }
    wrong = {(found.kind, found.part) for found in solution.contradictions}
    groups: dict[str, list[tuple[float, ConstantRow]]] = {}
    for found in solution.constants.values():
        kind = nuisance.kind(found.kind)
        prior = stated.get(found.name, found.prior)
        off = abs(found.value) / prior if prior > 0 else 0.0
        free = found.name == "square_scale" and extraction.board.square_m is None
        level = "wrong" if (found.kind, found.part) in wrong else "off" if off > _NAMED_SIGMAS else ""
        std = found.std * kind.shown
        row = ConstantRow(
            found.name,
            found.meaning,
            value_text(found.value * kind.shown, std, 3, "+"),
            std_text(std),
            "not stated" if free else "fixed" if prior == 0 else std_text(prior * kind.shown),
            kind.shown_unit,
            level,
        )
        rank = -off - (1e6 if level == "wrong" else 0.0)
        groups.setdefault(visible(found.part), []).append((rank if level else 0.0, row))
    ordered = sorted(groups.items(), key=lambda item: min(rank for rank, _ in item[1]))
    return tuple(
        (part, tuple(row for _, row in sorted(rows, key=lambda pair: pair[0]))) for part, rows in ordered
    )
