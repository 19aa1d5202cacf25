"""The board's size, found by itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mobilecal_cli.model import GrayImage
from mobilecal_cli.vision.detection import detect
from mobilecal_cli.vision.growing import grow_any
from mobilecal_cli.vision.values import Detection

# Corners that end the search for a grid to grow: with the first any will do, which is usually all of the board.
_ENOUGH = (1, 10_000)


@dataclass(frozen=True, slots=True)
class SizeVote:
    """What pictures say about the board's size.

    Attributes:
        size: (columns, rows) inner corners, columns the larger count; None when no picture shows a whole board
            or the pictures do not agree.
        votes: size → number of pictures that show a whole board of this size.
        pictures: how many were looked at.
    """

    size: tuple[int, int] | None
    votes: Mapping[tuple[int, int], int]
    pictures: int


def identify_size(images: Iterable[GrayImage], enough: int | None = None) -> SizeVote:
    """The board's size from a handful of pictures.

    In each picture a grid is grown from a few corners to the pattern's edge. It counts when the detector for
    boards of known size finds a board of that size too and lets it through its gate, which looks at whether the
    pattern goes on. More than half of the counting pictures must agree.

    Args:
        images: (height, width) grey pictures, some of which show the board.
        enough: so many that agree, with none against them, settle it; None: all pictures are looked at.
    """
    votes: Counter[tuple[int, int]] = Counter()
    pictures = 0
    for image in images:
        pictures += 1
        size = _size_in(image)
        if size is not None:
            votes[size] += 1
        if len(votes) == 1 and votes.total() == enough:
            break
    leading = votes.most_common(1)
    size = leading[0][0] if leading and 2 * leading[0][1] > votes.total() else None
    return SizeVote(size, dict(votes), pictures)


def _size_in(image: GrayImage) -> tuple[int, int] | None:
    """(columns, rows) of the whole board in a picture, None where it shows none."""
    for enough in _ENOUGH:
        grown = grow_any(image, enough)
        if grown is None:
            return None
        rows, columns = sorted(grown.grid.shape[:2])
        if isinstance(detect(image, columns, rows), Detection):
            return columns, rows
    return None
