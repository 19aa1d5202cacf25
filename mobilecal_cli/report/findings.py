"""The sentences on results beyond the nine parameters: contradictions, outliers, suggestions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from mobilecal_cli.likelihood.constants import kind_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import Evidence, Suggestion
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.solution import Outlier, Solution
from mobilecal_cli.model.text import capitalized, visible
from mobilecal_cli.report.numbers import decimals_of, parameters_of, station_names, std_text, value_text
from mobilecal_cli.report.use import STATED

#: Further constants of a group are named if they are so many standard deviations off.
_NAMED_SIGMAS = 2.0
#: Kinds of constants that the recording cannot tell apart.
SCALES = frozenset({"square_size", "baseline_length"})


_MEASURED_SQUARE = (
    "the size that the stereo pair measures at each station",
    "Check that camera_info belongs to these images, and state board.square_m in rig.yaml.",
)


def _part(evidence: Evidence) -> str:
    """The part of the robot, capitalized; head joints are named as joints."""
    if evidence.kind.startswith(("joint", "backlash")):
        return f"Joint {visible(evidence.part)}"
    if evidence.kind == "clock":
        return f"Clock of the {visible(evidence.part)}"
    return capitalized(evidence.part)


def contradiction_sentences(
    evidence: Evidence, solution: Solution, extraction: Extraction
) -> tuple[str, str]:
    """What the data contradict and by how much, and the cure."""
    scale, meanings = solution.scale, {name: c.meaning for name, c in solution.constants.items()}
    if evidence.kind in SCALES and scale is not None:
        percent, std = abs(100 * (scale.ratio - 1)), 100 * scale.std
        return (
            "The stated squares and the stereo baseline disagree by "
            f"{value_text(percent, std, 2)} ± {std_text(std)} %: with the stated baseline of "
            f"{scale.baseline_m * 1e3:.2f} mm, the squares measure {scale.square_m * scale.ratio * 1e3:.2f} mm "
            f"(stated: {scale.square_m * 1e3:.2f} mm).",
            "The recording cannot tell which of the two is wrong. Measure ten squares with a ruler. If they are as "
            "stated, recalibrate the stereo pair.",
        )
    measured = evidence.kind == "square_size" and extraction.board.square_m is None
    words = STATED[evidence.kind]
    stated, cure = _MEASURED_SQUARE if measured else (words.value, words.cure)
    if evidence.asked:
        stated = " and ".join(f"--prior {name}" for name in evidence.asked)
        cure = f"Correct {stated}, or leave it out."
    kind = kind_of(evidence.kind)
    priors = " and ".join(sorted({std_text(each.prior * kind.shown) for each in evidence.values.values()}))
    known = {name: (each.value, each.std) for name, each in evidence.values.items() if each.std is not None}
    sigmas = {
        name: abs(value) / math.hypot(std, evidence.values[name].prior)
        for name, (value, std) in known.items()
    }
    worst_first = sorted(sigmas, key=lambda name: -sigmas[name])
    differences = []
    for name in worst_first[:1] + [name for name in worst_first[1:] if sigmas[name] > _NAMED_SIGMAS]:
        value, std = (number * kind.shown for number in known[name])
        difference = f"{value_text(value, std, 3, '+')} ± {std_text(std)} {kind.shown_unit}"
        differences.append(f"{meanings.get(name, name)} differs by {difference}")
    if evidence.kind == "joint_scale" and any(value < -1 for value, _ in known.values()):
        cure = "The readings of this joint have the wrong sign: reverse them, or its axis in head.chain or in the URDF."
    together = f"{' and '.join(meanings.get(name, name) for name in evidence.values)} together differ"
    shown = " and ".join(differences) or together
    return f"{_part(evidence)}: {shown} from {stated} (prior {priors} {kind.shown_unit}).", cure


_LISTED = 3  # outliers of one kind that are listed singly
_KINDS = {
    "station": "stations whose images do not fit the others",
    "slip": "legs whose wheels do not fit the cameras: wheel slip or a moved board",
    "joint": "wrong joint readings",
    "corners": "stations with corners that do not fit the board",
}


#: Key of `Solution.error_parts` → what it is called in a sentence, and what to do if it is the largest.
ERROR_PARTS = {
    "corners": ("corners", "Calibrate the stereo pair again, and check that the board is flat."),
    "poses": ("poses", "Check how the poses are measured: their noise is larger than all else."),
    "joints": (
        "joint readings",
        "Check the head joints for play, the head chain in the URDF, and that the board does not swing.",
    ),
    "floor": ("the uneven floor", "Record on a flat floor, and check that the base does not rock."),
    "wheels": (
        "wheels", "Check the wheels for slip, and the board for a move, on the leg with the largest error.",
    ),
    "stamps": (
        "time stamps",
        "Check that images, joints and wheels are stamped when they are read, not when they arrive.",
    ),
    "lenses": (
        "lenses beside their models", "Calibrate the cameras with a distortion model that fits their lenses.",
    ),
    "turns": (
        "unequal turns, or wheels that are read one after the other",
        "Check tires, casters and load, and that both wheels are read at one time.",
    ),
}  # fmt: skip


def reprojection_sentence(solution: Solution) -> str:
    """What the reprojection error consists of, by kind of noise; "" where it is unknown."""
    parts_px = {name: part.px for name, part in solution.error_parts.items()}
    if solution.uncertainty is None or "corners" not in parts_px:
        return ""
    each = ", ".join(f"{ERROR_PARTS[name][0]} {std_text(px)} px" for name, px in parts_px.items())
    return (
        f"One corner coordinate has a noise of {std_text(solution.uncertainty.noise.pixel_px)} px. The reprojection "
        "error compares two stations, so it includes the robot's motion between them. Expected from the noise levels: "
        f"{each}; together {std_text(math.hypot(*parts_px.values()))} px."
    )


def _path(suggestion: Suggestion) -> str:
    """How the base gets to a suggested stop."""

    def turn(rad: float, what: str) -> str:
        degrees, side = abs(round(math.degrees(rad))), "left" if rad > 0 else "right"
        return f"{what} {side} by {degrees} degree{'' if degrees == 1 else 's'}" if degrees else ""

    drive = suggestion.drive_m
    driven = f"drive {'forward' if drive > 0 else 'back'} by {abs(drive):.1f} m" if drive else ""
    parts = turn(suggestion.turn_rad, "turn the base"), driven, turn(suggestion.face_rad, "turn")
    return ", then ".join(filter(None, parts)) or "do not move the base"


def suggestion_sentences(solution: Solution, extraction: Extraction) -> tuple[str, ...]:
    """What to record next, most useful first: base motion, head angles and expected standard deviation."""
    names, prismatic = extraction.rig.chain.joints, extraction.rig.chain.prismatic
    parameters, sentences = parameters_of(extraction.rig.sources.assumed_wheels), []
    for suggestion in solution.suggestions:
        shown = parameters[NINE.index(suggestion.worst)]
        head = ", ".join(
            f"{name} to {f'{at * 1e3:.0f} mm' if name in prismatic else f'{round(math.degrees(at))}°'}"
            for name, at in zip(names, suggestion.joints, strict=True)
        )
        now, then = suggestion.std_now * shown.per_unit, suggestion.std_then * shown.per_unit
        unit = f" {shown.unit}".rstrip()
        path, worst = _path(suggestion), suggestion.worst
        if solution.uncertainty is not None and solution.uncertainty.observable[NINE.index(worst)]:
            digits = decimals_of(then) + 1  # which show a change of a few percent
            gain = (
                f"the standard deviation of {shown.name}, the least certain parameter, falls by "
                f"{100 * (1 - then / now):.0f} %, from {now:.{digits}f} to {then:.{digits}f}{unit}"
            )
        else:
            gain = f"{shown.name}, now unobservable, gets a standard deviation of {std_text(then)}{unit}"
        board_in_view = f"{extraction.rig.cameras.cameras_words} the whole board"
        stop = f"Set {head}, so that {board_in_view}, and stop." if head else f"Stop where {board_in_view}."
        sentences.append(f"{capitalized(path)}. {stop} Expected result: {gain}.")
    return tuple(sentences)


def outlier_sentences(outliers: Sequence[Outlier], extraction: Extraction) -> Iterator[str]:
    """A few outliers of a kind singly; many as a count, their stations, and the first of them."""
    names = station_names(extraction)
    for kind, cause in _KINDS.items():
        mine = [outlier for outlier in outliers if outlier.kind == kind]
        if len(mine) <= _LISTED:
            yield from (outlier.text for outlier in mine)
            continue
        at = ", ".join("-".join(names[i] for i in outlier.observations) for outlier in mine)
        yield f"{len(mine)} {cause} ({at}). The first: {mine[0].text}"
