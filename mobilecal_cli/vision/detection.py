"""Detection of the board in one image: fast search, refinement, and acceptance checks; and of the board's size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mobilecal_cli.model import Board, FloatArray, GrayImage
from mobilecal_cli.vision.acceptance import (
    accepted,
    check_colors,
    check_sharpness,
    check_size,
    fit_board,
    outer_squares_whole,
)
from mobilecal_cli.vision.corner_model import refine, refine_widely
from mobilecal_cli.vision.grid import at_full_size, canonical, reduced, right_handed, smallest_edge_px
from mobilecal_cli.vision.grid_map import fit_grid
from mobilecal_cli.vision.growing import Grown, grow_any
from mobilecal_cli.vision.markers import detect_markers
from mobilecal_cli.vision.values import LARGE_PX, Appearance, Detection, Miss, Reason, Single

_SMALLEST_PICTURE = 64  # px; OpenCV refuses smaller ones
# For uneven light; slow in full images.
_ADAPTIVE = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_PAINTED = 1.2  # margin painted over beyond the corners, in squares
# Reasons that no other search changes.
_FINAL = (Reason.TOO_SMALL, Reason.LARGER, Reason.BLURRED)
_TELLING = 0.3  # share of the expected corners; a smaller grid is no evidence of the board
# Corner counts at which growing stops: the first usually covers the whole board, the second tries everything.
_ENOUGH = (1, 10_000)
_SMALLEST_BOARD = 12  # corners: 4 x 3
# Saddle points.
_BLUR = (5, 5), 1.0  # px; removes noise but keeps the corners of 7 px squares
_NEIGHBORS = np.ones((3, 3), np.uint8)
_WORTH = 0.02  # share of the strongest response; usually 1 % of the peaks exceed it, the others are noise
_FAINTEST = 0.1  # response of a corner in the same light, as a share of the board's weakest


def _classic(image: GrayImage, columns: int, rows: int, flags: int, scale: float = 1.0) -> FloatArray | None:
    """OpenCV's contour-based detector at full or reduced size: (rows, columns, 2) px of the full image."""
    picture = np.asarray(image) if scale == 1.0 else reduced(image, scale)
    if min(picture.shape) < _SMALLEST_PICTURE:
        return None
    complete, corners = cv2.findChessboardCorners(picture, (columns, rows), flags=flags)
    if not complete:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2)
    return at_full_size(grid, picture, image)


def _judge(image: GrayImage, grid: FloatArray) -> Detection | Miss:
    """Refine corners and apply the acceptance checks."""
    grid = right_handed(grid)
    if (small := check_size(grid)) is not None:
        return small
    grid = refine(image, grid, smallest_edge_px(grid))
    if (small := check_size(grid)) is not None:
        return small
    appearance = Appearance(outer_whole=outer_squares_whole(image, fit_grid(grid, image.shape)))
    grid = refine_widely(image, grid, smallest_edge_px(grid), appearance.outer_whole)
    fit, grid_map = fit_board(image, grid, appearance)
    dark_at_origin = check_colors(image, grid_map)
    blurred = check_sharpness(image, grid_map)
    # Blur affects the outer squares first: if both checks fail, report the blur.
    if isinstance(dark_at_origin, Miss) and (blurred is None or dark_at_origin.reason != Reason.OCCLUDED):
        return dark_at_origin
    if blurred is not None:
        return blurred
    order, dark_at_origin = canonical(fit.pixels.reshape(grid.shape), bool(dark_at_origin))
    appearance = replace(appearance, contrast_grey=-1.0 if dark_at_origin else 1.0)
    return accepted(fit, grid_map, appearance, order)


def detect(
    image: GrayImage, columns: int, rows: int, thorough: bool = True, alone: bool = False
) -> Detection | Miss:
    """Detect a board of known size in one image.

    The contour-based detector runs first (at half size in large images); its corners are refined and checked.
    If it fails, a grid is grown from any few corners found, which detects boards that the first detector
    misses and gives the reason if there is none. An image with a second board of the same size is a Miss,
    because the board cannot be identified.

    Args:
        image: (height, width) gray, 8 bits; may be read-only and have padded rows.
        columns, rows: inner corners.
        thorough: also grow a grid; takes ten times as long in images without a board.
        alone: skip the search for a second board.

    Returns:
        The corners, or the reason why there are none.
    """
    if min(image.shape) < _SMALLEST_PICTURE:
        return Miss(Reason.NO_BOARD, f"the image has only {image.shape[1]} x {image.shape[0]} px")
    scales = (0.5, 1.0) if image.shape[1] >= LARGE_PX else (1.0,)
    grids = (_classic(image, columns, rows, 0, scale) for scale in scales)
    grid = next((grid for grid in grids if grid is not None), None)
    result = _judge(image, grid) if grid is not None else None
    if not isinstance(result, Detection) and thorough:
        result = _thorough(image, columns, rows, result)
    if result is None:
        return Miss(Reason.NO_BOARD, f"no grid of {columns} x {rows} corners in the fast search")
    if isinstance(result, Detection) and not alone:
        other = _second(image, result, columns, rows)
        if other is not None:
            x, y = other.mean(axis=0)
            first_x, first_y = result.pixels.mean(axis=0)
            return Miss(
                Reason.SECOND_BOARD,
                f"boards of {columns} x {rows} at ({first_x:.0f}, {first_y:.0f}) and ({x:.0f}, {y:.0f}) px",
            )
    return result


def _second(image: GrayImage, first: Detection, columns: int, rows: int) -> FloatArray | None:
    """Corners of a second board of the same size, (M, 2) px; None if there is none."""
    painted = _painted_over(image, first, columns, rows, columns * rows)
    if painted is None:
        return None
    other = _classic(painted, columns, rows, 0, 0.5 if image.shape[1] >= LARGE_PX else 1.0)
    if other is None or not isinstance(_judge(painted, other), Detection):
        return None
    return other.reshape(-1, 2)


def _painted_over(
    image: GrayImage, first: Detection, columns: int, rows: int, least: int
) -> GrayImage | None:
    """The image without a board; None if it cannot show another one, of `least` corners."""
    grid_map = fit_grid(first.pixels.reshape(rows, columns, 2), image.shape)
    low, right, bottom = -_PAINTED, columns - 1 + _PAINTED, rows - 1 + _PAINTED
    hull = grid_map(np.array([[low, low], [right, low], [right, bottom], [low, bottom]]))
    painted = np.array(image)
    cv2.fillConvexPoly(painted, np.round(hull).astype(np.int32), float(np.mean(image)))
    return painted if may_show_board(painted, least, least_response(image, columns * rows)) else None


def _thorough(image: GrayImage, columns: int, rows: int, first: Miss | None) -> Detection | Miss:
    """Search for the board after the fast search failed or its corners were rejected."""
    if first is not None and first.reason in _FINAL:
        return first
    grown = grow_any(image, columns * rows)
    scale, reason = 0.25, Miss(Reason.NO_BOARD, f"no grid of {columns} x {rows} corners")
    if grown is not None and grown.grid.size >= 2 * _TELLING * columns * rows:
        grid = grown.grid
        if grid.shape[:2] == (columns, rows) != (rows, columns):
            grid = np.rot90(grid)
        if grid.shape[:2] == (rows, columns):
            return _judge(image, grid)
        scale, reason = 0.5 if image.shape[1] >= LARGE_PX else 1.0, _other_size(grown, columns, rows)
        if grown.open_sides == 0:
            return first or reason
    again = _classic(image, columns, rows, _ADAPTIVE, scale)
    judged = _judge(image, again) if again is not None else None
    return judged if isinstance(judged, Detection) else first or judged or reason


def _other_size(grown: Grown, columns: int, rows: int) -> Miss:
    """Why a grid that was grown is not the board."""
    size, wanted = sorted(grown.grid.shape[:2], reverse=True), sorted((columns, rows), reverse=True)
    numbers = f"found a grid of {size[0]} x {size[1]} corners, expected {columns} x {rows}"
    if (small := check_size(grown.grid)) is not None:
        return Miss(small.reason, f"{numbers}; {small.detail}")
    if size[0] >= wanted[0] and size[1] >= wanted[1]:
        return Miss(Reason.LARGER, numbers)
    if grown.open_sides == 0:
        return Miss(Reason.OTHER_SIZE, numbers)
    return Miss(Reason.OCCLUDED, f"{numbers}; {grown.open_sides} sides end inside the pattern")


def find_board(
    image: GrayImage, board: Board, thorough: bool = True, alone: bool = False
) -> Detection | Miss:
    """Detect the board in one image: see `detect` and `detect_markers`."""
    if board.markers is not None:
        return detect_markers(image, board)
    return detect(image, board.columns, board.rows, thorough, alone)


@dataclass(frozen=True, slots=True)
class SizeVote:
    """Estimate of the board's size from several images.

    Attributes:
        votes: size → number of images that show a whole board of this size.
        pictures: number of images examined.
        beside: number of images that show a second whole board, of another size.
    """

    votes: Counter[tuple[int, int]]
    pictures: int
    beside: int = 0

    @property
    def size(self) -> tuple[int, int] | None:
        """(columns, rows) inner corners, columns the larger count; None without a majority of the votes."""
        return next(
            (size for size, votes in self.votes.items() if 2 * votes > sum(self.votes.values())), None
        )


def identify_size(images: Iterable[GrayImage]) -> SizeVote:
    """Estimate the board's size from several images.

    A grid is grown from a few corners to the edge of the pattern in each image. The size counts when the
    detector for boards of known size also accepts it, which includes a check that the pattern ends there. The
    result needs a majority of the votes.

    Args:
        images: (height, width) gray images, some of which show the board.
    """
    sizes = [_sizes_in(image) for image in images]
    votes = Counter(size for some in sizes for size in some)
    return SizeVote(votes, len(sizes), sum(len(some) > 1 for some in sizes))


def _sizes_in(image: GrayImage) -> list[tuple[int, int]]:
    """(columns, rows) of the whole boards in an image, of at most two."""
    if (first := _whole_board(image)) is None:
        return []
    columns, rows, detection = first
    others = _painted_over(image, detection, columns, rows, _SMALLEST_BOARD)
    second = None if others is None else _whole_board(others)
    return [(columns, rows), *([] if second is None else [second[:2]])]


def _whole_board(image: GrayImage) -> tuple[int, int, Detection] | None:
    """Columns, rows and corners of a whole board in an image, None if there is none."""
    for enough in _ENOUGH:
        grown = grow_any(image, enough)
        if grown is None:
            return None
        rows, columns = sorted(grown.grid.shape[:2])
        detection = detect(image, columns, rows)
        if isinstance(detection, Detection):
            return columns, rows, detection
    return None


# A checkerboard corner is a saddle point of brightness: the determinant of the second derivatives is negative. All
# corners of a board have a similar response, and few images without a board have as many strong saddle points.


def may_show_board(image: GrayImage, corners: int, least: float) -> bool:
    """Whether there are as many saddle points with at least this response as the board has corners."""
    return least == 0 or len(_peaks(_responses(image), least)) >= corners


def least_response(image: GrayImage, corners: int) -> float:
    """Response that the corners of a board have in the light of an image that shows one; 0 for any."""
    responses = _responses(image)
    peaks = _peaks(responses, _WORTH * float(responses.max()))
    if len(peaks) < corners:
        return 0.0
    return _FAINTEST * float(np.partition(peaks, len(peaks) - corners)[len(peaks) - corners])


def _responses(image: GrayImage) -> Single:
    """Negative determinant of the second derivatives of an image at reduced size, in arbitrary units."""
    scale = 0.25 if image.shape[1] >= LARGE_PX else 0.5
    small = cv2.GaussianBlur(reduced(image, scale), *_BLUR)
    saddle, by_xx, by_yy = (
        np.asarray(cv2.Sobel(small, cv2.CV_32F, *by, ksize=3), np.float32) for by in ((1, 1), (2, 0), (0, 2))
    )
    saddle *= saddle
    by_xx *= by_yy
    saddle -= by_xx
    return saddle


def _peaks(responses: Single, least: float) -> Single:
    """Local maxima above a limit."""
    peaks: Single = responses[(responses > least) & (responses == cv2.dilate(responses, _NEIGHBORS))]
    return peaks
