"""Outliers in words, grouped by cause."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mobilecal_cli.model import Extraction, Outlier
from mobilecal_cli.report.numbers import station_names

_LISTED = 3  # outliers of one kind that are listed singly
_KINDS = {
    "station": "stations whose images do not fit the others: a moved or wrong board, or wrong joint readings",
    "slip": "legs whose wheels do not fit the cameras: wheel slip or a moved board",
    "joint": "wrong joint readings",
    "corners": "stations with corners that do not fit the board",
}
_NOISY = {"views": "stations' images", "legs": "legs' wheel rotations", "readings": "joint readings"}


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


def noisy_sentence(noisy: Sequence[str]) -> str:
    """What it means that so many measurements of some kinds looked like outliers."""
    which = " and of the ".join(_NOISY[kind] for kind in noisy)
    return (
        f"More than a third of the {which} differ from the rest: their noise is larger than usual. All of them are "
        "used, with the noise level that fits them."
    )
