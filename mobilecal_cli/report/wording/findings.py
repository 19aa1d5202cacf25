"""The sentences on results beyond the nine parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from mobilecal_cli.likelihood.budget import usual_jackknife_factor
from mobilecal_cli.model import NINE, Extraction, Outlier, ScaleCheck, Solution, Suggestion
from mobilecal_cli.report.numbers import station_names
from mobilecal_cli.report.parameters import BY_NAME, std_text

_LISTED = 3  # outliers of one kind that are listed singly
_KINDS = {
    "station": "stations whose images do not fit the others: a moved or wrong board, or wrong joint readings",
    "slip": "legs whose wheels do not fit the cameras: wheel slip or a moved board",
    "joint": "wrong joint readings",
    "corners": "stations with corners that do not fit the board",
}


def reprojection_sentence(parts_px: Mapping[str, float], noise_px: float) -> str:
    """What the reprojection error consists of; "" where it is unknown.

    Args:
        parts_px: kind of noise → the error that it causes.
        noise_px: of one corner coordinate.
    """
    if not parts_px:
        return ""
    words = {
        "corners": "corners",
        "joints": "joint readings",
        "floor": "the uneven floor",
        "wheels": "wheels",
    }
    each = [f"{words[name]} {std_text(px)} px" for name, px in parts_px.items()]
    whole = math.sqrt(sum(px**2 for px in parts_px.values()))
    return (
        f"One corner coordinate has a noise of {std_text(noise_px)} px. The reprojection error compares two "
        f"stations, so it includes the robot's motion between them. Expected from the noise levels: "
        f"{', '.join(each)}; together {std_text(whole)} px."
    )


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
        shown = BY_NAME[suggestion.worst]
        unit = shown.shown_unit
        head = ", ".join(
            f"{name} to {f'{at * 1e3:.0f} mm' if name in prismatic else f'{round(math.degrees(at))}°'}"
            for name, at in zip(names, suggestion.joints, strict=True)
        )
        now, then = suggestion.std_now * shown.factor, suggestion.std_then * shown.factor
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
