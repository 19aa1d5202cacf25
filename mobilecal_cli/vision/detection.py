"""Detection of the board in one image: fast search, growth of a grid, refinement, checks; and of the board's size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mobilecal_cli.model.arrays import FloatArray, GrayImage
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.vision.acceptance import (
    accepted,
    check_colors,
    check_sharpness,
    check_size,
    colors,
    fit_board,
    outer_squares_whole,
    sample,
)
from mobilecal_cli.vision.corner_model import refine, refine_widely
from mobilecal_cli.vision.grid import at_full_size, canonical, reduced, right_handed, smallest_edge_px
from mobilecal_cli.vision.grid_map import fit_grid
from mobilecal_cli.vision.markers import detect_markers
from mobilecal_cli.vision.values import LARGE_PX, Appearance, Detection, Miss, Single

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
# Growth of a grid of any size from a few corners to the edge of the board.
_SEEDS = ((3, 3), (5, 4))  # corners that the seed must have: each finds boards that the other misses
_MIN_GROWN_PX = 4.0  # below, nothing is left of a square's color in its quadrants
_MIN_STRENGTH_GREY = 8.0  # least contrast between quadrants, a few times the noise
_LARGEST = 60  # largest number of corners along one side
_QUADRANT = 0.22  # distance of the samples from a corner along both sides, in squares
_LEAST = 0.3  # least strength of a corner, as a share of the median


@dataclass(frozen=True, slots=True)
class Grown:
    """A grid of corners grown as far as possible.

    Attributes:
        grid: (rows, columns, 2) px, right-handed.
        open_sides: number of sides where the next line of corners is partly visible or outside the image.
    """

    grid: FloatArray
    open_sides: int


def _alternating(grid: FloatArray, image: GrayImage) -> FloatArray:
    """Contrast of the four quadrants around every corner of (rows, columns, 2), gray levels, with the expected sign.

    The smallest difference between neighboring quadrants; 0 if the signs disagree.
    """
    dv, du = np.gradient(grid, axis=(0, 1))
    quadrant = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    q = [sample(image, grid + _QUADRANT * (a * du + b * dv)) for a, b in quadrant]
    values = np.stack([value for value, _ in q])
    inside = np.all([good for _, good in q], axis=0)
    differences = np.stack([s * (values[i] - values[(i + 1) % 4]) for i, s in enumerate((1, -1, 1, -1))])
    agree = np.all(differences > 0, axis=0) | np.all(differences < 0, axis=0)
    weakest = np.take_along_axis(differences, np.argmin(np.abs(differences), axis=0)[None], axis=0)[0]
    return colors(*grid.shape[:2]) * np.where(agree & inside, weakest, 0.0)


def _trim(grid: FloatArray, image: GrayImage) -> FloatArray | None:
    """Remove outer lines with false corners, worst first; None if too few lines are left."""
    while min(grid.shape[:2]) >= 3:
        strength = _alternating(grid, image)
        median = float(np.median(strength))
        if abs(median) < _MIN_STRENGTH_GREY or smallest_edge_px(grid) < _MIN_GROWN_PX:
            return None
        bad = strength * np.sign(median) < _LEAST * abs(median)
        if not bad.any():
            return grid
        lines = {0: bad[0].mean(), 1: bad[-1].mean(), 2: bad[:, 0].mean(), 3: bad[:, -1].mean()}
        worst = max(lines, key=lambda k: float(lines[k]))
        if lines[worst] == 0:
            return None  # false corners inside the grid
        grid = (grid[1:], grid[:-1], grid[:, 1:], grid[:, :-1])[worst]
    return None


def _next_line(grid: FloatArray, image: GrayImage) -> tuple[FloatArray | None, bool]:
    """The grid extended by one row, or None; and whether part of that row is visible."""
    rows, columns = grid.shape[:2]
    grid_map = fit_grid(grid, image.shape)
    uv = np.stack([np.arange(columns), np.full(columns, rows)], axis=-1).astype(np.float64)
    guess = grid_map(uv)
    height, width = image.shape
    inside = np.all((guess > 2) & (guess < [width - 3, height - 3]), axis=-1)
    edge = float(np.linalg.norm(guess - grid[-1], axis=-1).min())
    if not inside.any() or edge < 3:
        return None, not inside.all()
    line = guess.copy()
    moved = refine(image, guess[inside], min(edge, smallest_edge_px(grid)))
    near = np.linalg.norm(moved - guess[inside], axis=-1) < 0.35 * edge
    line[inside] = np.where(near[:, None], moved, guess[inside])
    longer = np.concatenate([grid, line[None]])
    strength = _alternating(longer, image)
    median = float(np.median(strength[:-1]))
    there = (strength[-1] * np.sign(median) >= _LEAST * abs(median)) & inside
    if there.all():
        return longer, True
    return None, bool(there.mean() >= 0.3 or not inside.all())


def grow(image: GrayImage, seed: FloatArray) -> Grown | None:
    """Remove false outer lines from a grid, then add lines on all four sides while they are fully visible.

    Args:
        image: (height, width) gray.
        seed: (rows, columns, 2) px, corners of any detector, possibly with false ones.
    """
    grid = _trim(right_handed(seed), image)
    if grid is None:
        return None
    grid = refine(image, grid, smallest_edge_px(grid))
    grid = _trim(grid, image)
    if grid is None:
        return None
    open_sides, closed = 0, 0
    while closed < 4 and max(grid.shape[:2]) < _LARGEST:
        longer, partly = _next_line(grid, image)
        if longer is not None:
            grid, open_sides, closed = longer, 0, 0
        else:
            closed += 1
            open_sides += partly
            grid = np.rot90(grid)  # four quarter turns cover all four sides
    return Grown(right_handed(grid), open_sides)


def _seed(image: GrayImage, smallest: tuple[int, int]) -> FloatArray | None:
    """A few corners of any checkerboard, (rows, columns, 2) px, by OpenCV's sector-based detector.

    Its board size and its sub-pixel positions are unreliable; `grow` corrects both.
    """
    picture = reduced(image, 0.5) if image.shape[1] >= LARGE_PX else image
    cv2.setRNGSeed(0)  # the detector draws random samples; a fixed seed makes it repeatable
    complete, corners, meta = cv2.findChessboardCornersSBWithMeta(picture, smallest, cv2.CALIB_CB_LARGER)
    if not complete:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(*meta.shape[:2], 2)
    return at_full_size(grid, picture, image)


def grow_any(image: GrayImage, enough: int) -> Grown | None:
    """The largest grid that can be grown in an image; the search ends at `enough` corners."""
    best: Grown | None = None
    for smallest in _SEEDS:
        seed = _seed(image, smallest)
        grown = grow(image, seed) if seed is not None else None
        if grown is not None and (best is None or grown.grid.size > best.grid.size):
            best = grown
        if seed is None or (best is not None and best.grid.size >= 2 * enough):
            break
    return best


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
