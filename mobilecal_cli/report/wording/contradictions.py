"""The sentences on stated values that the data contradict: what is wrong, against what, and its cure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import Evidence, ScaleCheck
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.parameters import std_text, value_text
from mobilecal_cli.report.wording.words import Words

#: Further constants of a group are named if they are so many standard deviations off.
_NAMED_SIGMAS = 2.0
#: Kinds of constants that the recording cannot tell apart.
SCALES = frozenset({"square_size", "baseline_length"})


@dataclass(frozen=True, slots=True)
class _Stated:
    """What is said about one kind of constants.

    Attributes:
        against: the stated value, after "from".
        cure: in whole sentences.
    """

    against: str
    cure: str


_CAMERA = _Stated(
    "camera_info",
    "Check that camera_info belongs to these images (resolution, crop). Calibrate the camera again, or use the "
    "exported camera_info.",
)
_PAIR = _Stated("camera_info", "Recalibrate the stereo pair, or use the exported camera_info.")
_HEAD = _Stated("the URDF", "Correct the URDF, or use the exported URDF.")
_BY_KIND = {
    "clock": _Stated("equal clocks", "Synchronize the clocks (NTP or PTP) and record again."),
    "stereo_clock": _Stated(
        "simultaneous images", "Trigger both cameras together, or stop for images, and record again."
    ),
    "readout": _Stated(
        "a global shutter",
        "State priors.readout in rig.yaml (in ms), or stop for images, and record again.",
    ),
    "focal_length": _CAMERA,
    "focal_aspect": _CAMERA,
    "principal_point": _CAMERA,
    "distortion": _CAMERA,
    "stereo_rotation": _PAIR,
    "baseline_direction": _PAIR,
    "baseline_length": _PAIR,
    "square_size": _Stated(
        "the stated size",
        "Measure ten squares with a ruler, and correct board.square_m in rig.yaml.",
    ),
    "square_aspect": _Stated(
        "square", "Print the board again without scaling, and measure it in both directions."
    ),
    "board_bend": _Stated("a flat board", "Mount the board on a flat plate and record again."),
    "board_shear": _Stated(
        "a right angle", "Print the board again on a printer that does not skew, and measure it."
    ),
    "board_corners": _Stated(
        "corners in their places", "Print the board again, and mount it on a flat plate."
    ),
    "lean": _Stated(
        "an upright base", "Check tires and casters for size and wear, and the axes of the base in the URDF."
    ),
    "joint_zero": _HEAD,
    "joint_scale": _Stated(
        "the reading", "Check the gear ratio or the encoder counts of this joint, or use the exported URDF."
    ),
    "joint_axis": _HEAD,
    "joint_position": _HEAD,
    "backlash": _Stated("no backlash", "Repair the joint, or approach each head pose from the same side."),
}
_MEASURED_SQUARE = _Stated(
    "the size that the stereo pair measures at each station",
    "Check that camera_info belongs to these images, and state board.square_m in rig.yaml.",
)
_SCALE_CURE = (
    "The recording cannot tell which of the two is wrong. Measure ten squares with a ruler. If they are as stated, "
    "recalibrate the stereo pair."
)
_SEVERAL = " Several stated values are contradicted, so the priors of all other constants are widened too."


def part_text(found: Evidence) -> str:
    """The part of the robot, capitalized; head joints are named as joints."""
    if found.kind.startswith(("joint", "backlash")):
        return f"Joint {visible(found.part)}"
    if found.kind == "clock":
        return f"Clock of the {visible(found.part)}"
    return f"{found.part[0].upper()}{found.part[1:]}"


def contradiction_words(c: Check) -> Words:
    """A contradiction."""
    what, cure = contradiction_sentences(
        c.facts["evidence"], c.facts["scale"], c.facts["meanings"], c.facts["square_stated"]
    )
    widened = _SEVERAL if c.facts["several"] else ""
    return Words(
        f"robot description: {visible(c.facts['evidence'].part)}, {nuisance.kind(c.facts['evidence'].kind).meaning}",
        f"{c.value:.1f} sigma from the stated values",
        f"at most {c.limit:g} sigma",
        f"{what} It changes the result by up to {c.facts['evidence'].shift_sigmas:.1f} standard deviations.{widened}",
        cure,
    )


def contradiction_sentences(
    found: Evidence, scale: ScaleCheck | None, meanings: Mapping[str, str], square_stated: bool
) -> tuple[str, str]:
    """What the data contradict and by how much, and the cure.

    Args:
        found: the contradiction.
        scale: stated squares against the baseline, if both are stated.
        meanings: constant → its meaning.
        square_stated: whether a size of the squares is stated.
    """
    if found.kind in SCALES and scale is not None:
        off = (
            f"{value_text(abs(100 * (scale.ratio - 1)), 100 * scale.std, 2)} ± {std_text(100 * scale.std)} %"
        )
        return (
            f"The stated squares and the stereo baseline disagree by {off}: with the stated baseline of "
            f"{scale.baseline_m * 1e3:.2f} mm, the squares measure {scale.square_m * scale.ratio * 1e3:.2f} mm "
            f"(stated: {scale.square_m * 1e3:.2f} mm).",
            _SCALE_CURE,
        )
    measured = found.kind == "square_size" and not square_stated
    stated = _MEASURED_SQUARE if measured else _BY_KIND[found.kind]
    shown = (
        " and ".join(_difference(found, name, meanings) for name in _worst(found))
    ) or f"{' and '.join(meanings.get(name, name) for name in found.values)} together differ"
    return f"{part_text(found)}: {shown} from {stated.against} ({_prior(found)}).", stated.cure


def _worst(found: Evidence) -> tuple[str, ...]:
    """The constants that are off, worst first."""
    off = {
        name: abs(value) / math.hypot(std, found.priors[name])
        for name, (value, std) in found.values.items()
        if math.isfinite(std)
    }
    ranked = sorted(off, key=lambda name: -off[name])
    return tuple(ranked[:1] + [name for name in ranked[1:] if off[name] > _NAMED_SIGMAS])


def _difference(found: Evidence, name: str, meanings: Mapping[str, str]) -> str:
    kind, (value, std) = nuisance.kind(found.kind), found.values[name]
    shown = value_text(value * kind.shown, std * kind.shown, 3, "+")
    return f"{meanings.get(name, name)} differs by {shown} ± {std_text(std * kind.shown)} {kind.shown_unit}"


def _prior(found: Evidence) -> str:
    kind = nuisance.kind(found.kind)
    priors = sorted({std_text(prior * kind.shown) for prior in found.priors.values()})
    return f"prior {' and '.join(priors)} {kind.shown_unit}"
