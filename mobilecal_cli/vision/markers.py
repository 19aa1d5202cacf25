"""Detection of boards with markers, whole or in part: ChArUco boards and AprilTag grids."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model.arrays import FloatArray, GrayImage, IntArray
from mobilecal_cli.model.rig import Board, Markers
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.vision.acceptance import MIN_EDGE_PX
from mobilecal_cli.vision.corner_model import fit_corners
from mobilecal_cli.vision.grid_map import scatter_px
from mobilecal_cli.vision.values import FLOOR_PX, LEAST_CORNERS, Appearance, Detection, Miss, rms

_READ_PX = 2  # of a marker's cell: most are read from here on
# Where a cell has fewer pixels, or no marker is read, the image is enlarged so many times: of cells with 2 px, four
# times as many tags are read.
_SMALL_PX, _LARGER = 3, 3
_LEAST_TAGS = 3  # fewer do not determine the board's pose
_FLOOR_PX = 0.02  # error of OpenCV's refinement on images without noise
_OF_ROOM, _LEAST_WINDOW = 0.65, 3  # half window: share of the distance to the next edge, and least, px
_MOST = 0.5  # share of corners that the model must fit: where markers are too near, some are wrong
_OTHER_PLACE, _OTHER_SIDE = 0.2, 0.02  # of a tag's side: places and sides that are those of another board
_ENOUGH = 4  # markers, so that their number is not why there is no board
_SHARP_PX = 0.5  # blur of the first fit: least is left out beside the markers
_LEAST_GRID, _FAR_PX = 3, 1e5  # corners along a side, for differences of second order; far outside any image
_GROSS_SIGMAS, _GROSS_PX = 5.0, 0.5  # a corner so far off the others is another one
_GROSS_FITTED_PX = 0.1  # or is fitted to the edge of its marker


def detect_markers(image: GrayImage, board: Board) -> Detection | Miss:
    """Detect a board with markers, or the visible part of it.

    Args:
        image: (height, width) gray, 8 bits.
        board: with `markers`.

    Returns:
        The visible corners, or the reason why there are too few.
    """
    markers = board.markers
    assert markers is not None
    find = _charuco if markers.kind == "charuco" else _tags
    corners = find(np.ascontiguousarray(image), board, markers)
    if isinstance(corners, Miss):
        return corners
    pixels, good = np.zeros((board.corners, 2)), np.zeros(board.corners, dtype=np.bool_)
    numbers, places, cov = corners
    pixels[numbers], good[numbers] = places, True
    grid = board.grid()[:, :2]
    for _ in range(3):
        if good.sum() < LEAST_CORNERS or np.linalg.matrix_rank(grid[good] - grid[good].mean(axis=0)) < 2:
            return Miss(
                Reason.OCCLUDED,
                f"{good.sum()} of {board.corners} corners visible, minimum {LEAST_CORNERS} that are not on one line",
            )
        off = np.linalg.norm(scatter_px(grid[good], pixels[good]), axis=1)
        usual = float(np.median(off)) / 1.1774
        gross = off > max(_GROSS_SIGMAS * usual, _GROSS_PX if cov is None else _GROSS_FITTED_PX)
        if not gross.any():
            break
        good[np.flatnonzero(good)[gross]] = False
    # Side of a square in the image, from the best affine map.
    affine = np.linalg.lstsq(np.hstack([grid[good], np.ones((good.sum(), 1))]), pixels[good], rcond=None)[0]
    edge = float(np.linalg.svd(affine[:2], compute_uv=False).min())
    if edge < MIN_EDGE_PX:
        return Miss(Reason.TOO_SMALL, f"square side {edge:.1f} px, minimum {MIN_EDGE_PX:.0f} px")
    sigma_px = max(rms(scatter_px(grid[good], pixels[good])), _FLOOR_PX if cov is None else FLOOR_PX)
    pixels = np.where(good[:, None], pixels, 0.0)
    if cov is None:
        return Detection(pixels, sigma_px, good)
    every = np.tile(sigma_px**2 * np.eye(2), (board.corners, 1, 1))
    every[numbers] = cov
    return Detection(pixels, sigma_px, good, every)


def readable_words(board: Board | None) -> str:
    """What must be how large in an image for the board to be found, for messages; None: any checkerboard."""
    if board is None or board.markers is None:
        squares = f"squares of {MIN_EDGE_PX:.0f} pixels or more"
        return squares if board is not None else f"3 x 3 inner corners or more and {squares}"
    markers = board.markers
    side = _READ_PX * _cells(markers)
    border = " and board.border_bits match" if markers.kind == "aprilgrid" else " matches"
    return f"markers of {side} pixels or more, and check that board.dictionary ({markers.dictionary}){border} the board"


def _dictionary(markers: Markers, count: int) -> cv2.aruco.Dictionary:
    """Dictionary of only the board's markers, numbered from 0: a larger one makes the search slower."""
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
    own = np.ascontiguousarray(family.bytesList[markers.first_id : markers.first_id + count])
    return cv2.aruco.Dictionary(own, family.markerSize, family.maxCorrectionBits)


def _cells(markers: Markers) -> int:
    """Cells of a marker along its side, with its border."""
    return int(_dictionary(markers, 1).markerSize + 2 * markers.border_bits)


def _parameters(markers: Markers) -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = markers.border_bits
    return parameters


def _read(image: GrayImage, markers: Markers, count: int) -> tuple[IntArray, FloatArray]:
    """Numbers of the visible markers, (n,), and their outlines, (n, 4, 2) px; small ones in the enlarged image."""
    detector = cv2.aruco.ArucoDetector(_dictionary(markers, count), _parameters(markers))
    numbers, outlines = _read_at(1, image, detector)
    least_px = _SMALL_PX * _cells(markers)
    if not len(numbers) or np.median(_sides(outlines)) < least_px:
        numbers, outlines = max(
            (numbers, outlines), _read_at(_LARGER, image, detector), key=lambda r: len(r[0])
        )
    return numbers, outlines


def _read_at(scale: int, image: GrayImage, detector: cv2.aruco.ArucoDetector) -> tuple[IntArray, FloatArray]:
    height, width = image.shape
    large = cv2.resize(image, (scale * width, scale * height), interpolation=cv2.INTER_CUBIC)
    outlines, numbers, _ = detector.detectMarkers(large)
    if numbers is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2))
    places = (np.asarray(outlines, dtype=np.float64).reshape(-1, 4, 2) + 0.5) / scale - 0.5
    return np.asarray(numbers, dtype=np.int64).ravel(), places


def _charuco(
    image: GrayImage, board: Board, markers: Markers
) -> tuple[IntArray, FloatArray, FloatArray | None] | Miss:
    """Numbers of the visible corners, their pixels (n, 2), and their covariances (n, 2, 2), px^2, if they are known."""
    squares = (board.columns + 1, board.rows + 1)
    count = squares[0] * squares[1] // 2
    read, outlines = _read(image, markers, count)
    if not len(read):
        return Miss(Reason.NO_BOARD, f"no markers of {markers.dictionary}")
    places = [outline[None].astype(np.float32) for outline in outlines]
    for legacy in (False, True):  # the pattern of earlier versions of OpenCV begins with a white square
        drawn = cv2.aruco.CharucoBoard(squares, 1.0, markers.share, _dictionary(markers, count))
        drawn.setLegacyPattern(legacy)
        detector = cv2.aruco.CharucoDetector(drawn, cv2.aruco.CharucoParameters(), _parameters(markers))
        corners, numbers, _, _ = detector.detectBoard(
            image, None, None, places, read.astype(np.int32)[:, None]
        )
        if corners is not None and numbers is not None and len(numbers):
            break
    else:
        if len(read) < _ENOUGH:
            return Miss(Reason.NO_BOARD, f"no markers of {markers.dictionary} with corners")
        where = f"a board of {board.columns} x {board.rows} inner corners has them"
        return Miss(
            Reason.OTHER_MARKERS,
            f"{len(read)} markers of {markers.dictionary} are read, but not where {where}",
        )
    return _fitted(
        image,
        board,
        np.asarray(numbers, dtype=np.int64).ravel(),
        np.asarray(corners, dtype=np.float64).reshape(-1, 2),
        outlines,
    )


def _fitted(
    image: GrayImage, board: Board, numbers: IntArray, pixels: FloatArray, outlines: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray | None] | Miss:
    """Corners of a ChArUco board by the model of all corners, see `_charuco`.

    OpenCV's lean on the markers: by 0.1 % of the board's size, they are too near to its middle.

    Args:
        numbers, pixels: (n,), (n, 2) px those that OpenCV finds.
        outlines: (m, 4, 2) px of the markers.
    """
    assert board.markers is not None
    grid, H = board.grid()[:, :2], None
    if len(numbers) >= LEAST_CORNERS and min(board.columns, board.rows) >= _LEAST_GRID:
        H, _ = cv2.findHomography(grid[numbers], pixels)
    if H is None:
        return numbers, pixels, None
    every = np.clip(cv2.perspectiveTransform(grid[None], H)[0], -_FAR_PX, _FAR_PX)
    every[numbers] = pixels
    # Markers may be larger than stated, and come nearer to the corners of their squares.
    flat = np.asarray(cv2.perspectiveTransform(outlines, np.linalg.inv(H)), np.float64)
    share = max(board.markers.share, float(np.median(_sides(flat))))
    start, margin = every.reshape(board.rows, board.columns, 2), (1 - share) / 2
    first = fit_corners(image, start, Appearance(_SHARP_PX), margin)
    fit = fit_corners(image, start, Appearance(first.blur_px), margin)
    fitted = fit.fitted[numbers]
    if np.mean(fitted) < _MOST:
        return Miss(
            Reason.TOO_SMALL, f"{fitted.sum()} of {len(numbers)} corners are far enough from their markers"
        )
    return numbers[fitted], fit.pixels[numbers[fitted]], fit.cov[numbers[fitted]]


def _tags(image: GrayImage, board: Board, markers: Markers) -> tuple[IntArray, FloatArray, None] | Miss:
    """Numbers of the visible tags' corners, and their pixels (n, 2)."""
    tags, outlines = _read(image, markers, board.columns * board.rows)
    # A tag that appears twice belongs to another board, or is a false detection.
    mine = np.array([np.sum(tags == tag) == 1 for tag in tags], dtype=np.bool_)
    if mine.sum() < _LEAST_TAGS:
        return Miss(
            Reason.NO_BOARD, f"{mine.sum()} tags of {markers.dictionary} visible, minimum {_LEAST_TAGS}"
        )
    quads = outlines[mine]
    grid = board.grid()[:, :2].reshape(-1, 4, 2)[tags[mine]]
    # Families differ in which corner of a tag is the first; the grid of tags determines it.
    options = [np.roll(quads, k, axis=1) for k in range(4)]
    best = min(options, key=lambda quad: rms(scatter_px(grid.reshape(-1, 2), quad.reshape(-1, 2))))
    corners = (4 * tags[mine][:, None] + np.arange(4)).ravel()
    places = _refined(image, best, markers)
    if len(quads) >= _ENOUGH and (other := _arranged_otherwise(grid, places, markers)):
        return Miss(Reason.OTHER_MARKERS, other)
    return corners, places.reshape(-1, 2), None


def _arranged_otherwise(grid: FloatArray, quads: FloatArray, markers: Markers) -> str:
    """How tags (n, 4, 2) px are arranged, if it is not as on the stated board, (n, 4, 2) in sides; "" if it is."""
    stated, seen = grid.mean(axis=1), quads.mean(axis=1)
    H, _ = cv2.findHomography(stated, seen)
    if H is None:
        return ""
    off_px = np.linalg.norm(cv2.perspectiveTransform(stated[None], H)[0] - seen, axis=1)
    if np.median(off_px) > _OTHER_PLACE * np.median(_sides(quads)):
        return f"{len(quads)} tags of {markers.dictionary} are read, but not in the stated columns and rows"
    side = float(np.median(_sides(np.asarray(cv2.perspectiveTransform(quads, np.linalg.inv(H)), np.float64))))
    if abs(side - 1) > _OTHER_SIDE:
        gap = (1 + markers.share) / side - 1
        return f"the gap between tags is {gap:.2g} of their side, but board.gap_share is {markers.share:g}"
    return ""


def _sides(quads: FloatArray) -> FloatArray:
    """(n, 3) lengths of sides of quadrilaterals (n, 4, 2)."""
    return np.asarray(np.linalg.norm(np.diff(quads, axis=1), axis=-1))


def _refined(image: GrayImage, quads: FloatArray, markers: Markers) -> FloatArray:
    """Refine corners of tags, (n, 4, 2) px, to the intersection of the edges.

    The window reaches neither the code inside the border nor the next tag's edge, which would bias the
    result.
    """
    edge = float(np.median(_sides(quads)))
    border = markers.border_bits / _cells(markers)
    room = min(border, markers.share) if markers.share else border
    half = max(_LEAST_WINDOW, int(_OF_ROOM * room * edge))
    corners = quads.reshape(-1, 1, 2).astype(np.float32)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    cv2.cornerSubPix(image, corners, (half, half), (-1, -1), until)
    return np.asarray(corners.reshape(quads.shape), dtype=np.float64)
