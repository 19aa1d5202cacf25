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
