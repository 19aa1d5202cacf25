"""Estimation of the board's size from images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mobilecal_cli.model import GrayImage
from mobilecal_cli.vision.detection import detect
from mobilecal_cli.vision.growing import grow_any
from mobilecal_cli.vision.values import Detection

# Corner counts at which growing stops: the first usually covers the whole board, the second tries everything.
_ENOUGH = (1, 10_000)


@dataclass(frozen=True, slots=True)
class SizeVote:
    """Estimate of the board's size from several images.

    Attributes:
        size: (columns, rows) inner corners, columns the larger count; None when no image shows a whole board
            or no size has a majority.
        votes: size → number of images that show a whole board of this size.
        pictures: number of images examined.
    """

    size: tuple[int, int] | None
    votes: Mapping[tuple[int, int], int]
    pictures: int


def identify_size(images: Iterable[GrayImage], enough: int | None = None) -> SizeVote:
    """Estimate the board's size from several images.

    A grid is grown from a few corners to the edge of the pattern in each image. The size counts when the
    detector for boards of known size also accepts it, which includes a check that the pattern ends there. The
    result needs a majority of the votes.

    Args:
        images: (height, width) gray images, some of which show the board.
        enough: stop after this number of votes if they all agree; None examines all images.
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
    """(columns, rows) of the whole board in an image, None if there is none."""
    for enough in _ENOUGH:
        grown = grow_any(image, enough)
        if grown is None:
            return None
        rows, columns = sorted(grown.grid.shape[:2])
        if isinstance(detect(image, columns, rows), Detection):
            return columns, rows
    return None
