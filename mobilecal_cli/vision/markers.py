"""Detection of boards with markers, whole or in part: ChArUco boards and AprilTag grids."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import Board, FloatArray, GrayImage, IntArray, Markers
from mobilecal_cli.vision.acceptance import MIN_EDGE_PX
from mobilecal_cli.vision.grid_map import scatter_px
from mobilecal_cli.vision.values import LEAST_CORNERS, OCCLUDED, Detection, Miss, rms

_READ_PX = 2  # of a marker's cell: most are read from here on
# Where a cell has fewer pixels, or no marker is read, the image is enlarged so many times: of cells with 2 px, four
# times as many tags are read.
_SMALL_PX, _LARGER = 3, 3
_LEAST_TAGS = 3  # fewer do not determine the board's pose
_FLOOR_PX = 0.02  # error of OpenCV's refinement on images without noise
_OF_ROOM, _LEAST_WINDOW = 0.65, 3  # half window: share of the distance to the next edge, and least, px
_GROSS_SIGMAS, _GROSS_PX = 5.0, 0.5  # a corner so far off the others is another one


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
    numbers, places = corners
    pixels[numbers], good[numbers] = places, True
    grid = board.grid()[:, :2]
    for _ in range(3):
        if good.sum() < LEAST_CORNERS or np.linalg.matrix_rank(grid[good] - grid[good].mean(axis=0)) < 2:
            return Miss(
                OCCLUDED,
                f"{good.sum()} of {board.corners} corners visible, minimum {LEAST_CORNERS} that are not on one line",
            )
        off = np.linalg.norm(scatter_px(grid[good], pixels[good]), axis=1)
        usual = float(np.median(off)) / 1.1774
        gross = off > max(_GROSS_SIGMAS * usual, _GROSS_PX)
        if not gross.any():
            break
        good[np.flatnonzero(good)[gross]] = False
    edge = _edge_px(grid[good], pixels[good])
    if edge < MIN_EDGE_PX:
        return Miss("squares too small", f"square side {edge:.1f} px, minimum {MIN_EDGE_PX:.0f} px")
    sigma_px = max(rms(scatter_px(grid[good], pixels[good])), _FLOOR_PX)
    return Detection(np.where(good[:, None], pixels, 0.0), sigma_px, good)


def _edge_px(grid: FloatArray, pixels: FloatArray) -> float:
    """Side of a square in the image, from the best affine map, px."""
    wide = np.hstack([grid, np.ones((len(grid), 1))])
    affine = np.linalg.lstsq(wide, pixels, rcond=None)[0][:2]
    return float(np.linalg.svd(affine, compute_uv=False).min())


def readable_words(board: Board | None) -> str:
    """What must be how large in an image for the board to be found, for messages; None: any checkerboard."""
    if board is None or board.markers is None:
        squares = f"squares of {MIN_EDGE_PX:.0f} pixels or more"
        return squares if board is not None else f"3 x 3 inner corners or more and {squares}"
    markers = board.markers
    side = _READ_PX * _cells(markers)
    return f"markers of {side} pixels or more, and check that board.dictionary ({markers.dictionary}) matches the board"


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
    if not len(numbers) or np.median(np.linalg.norm(np.diff(outlines, axis=1), axis=-1)) < least_px:
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


def _charuco(image: GrayImage, board: Board, markers: Markers) -> tuple[IntArray, FloatArray] | Miss:
    """Numbers of the visible corners, and their pixels (n, 2)."""
    squares = (board.columns + 1, board.rows + 1)
    count = squares[0] * squares[1] // 2
    drawn = cv2.aruco.CharucoBoard(squares, 1.0, markers.share, _dictionary(markers, count))
    detector = cv2.aruco.CharucoDetector(drawn, cv2.aruco.CharucoParameters(), _parameters(markers))
    read, outlines = _read(image, markers, count)
    if not len(read):
        return Miss("no board found", f"no markers of {markers.dictionary}")
    places = [outline[None].astype(np.float32) for outline in outlines]
    corners, numbers, _, _ = detector.detectBoard(image, None, None, places, read.astype(np.int32)[:, None])
    if corners is None or numbers is None or not len(numbers):
        return Miss("no board found", f"no markers of {markers.dictionary} with corners")
    return np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _tags(image: GrayImage, board: Board, markers: Markers) -> tuple[IntArray, FloatArray] | Miss:
    """Numbers of the visible tags' corners, and their pixels (n, 2)."""
    tags, outlines = _read(image, markers, board.columns * board.rows)
    # A tag that appears twice belongs to another board, or is a false detection.
    mine = np.array([np.sum(tags == tag) == 1 for tag in tags], dtype=np.bool_)
    if mine.sum() < _LEAST_TAGS:
        return Miss(
            "no board found", f"{mine.sum()} tags of {markers.dictionary} visible, minimum {_LEAST_TAGS}"
        )
    quads = outlines[mine]
    grid = board.grid()[:, :2].reshape(-1, 4, 2)[tags[mine]]
    # Families differ in which corner of a tag is the first; the grid of tags determines it.
    options = [np.roll(quads, k, axis=1) for k in range(4)]
    best = min(options, key=lambda quad: rms(scatter_px(grid.reshape(-1, 2), quad.reshape(-1, 2))))
    corners = (4 * tags[mine][:, None] + np.arange(4)).ravel()
    return corners, _refined(image, best, markers).reshape(-1, 2)


def _refined(image: GrayImage, quads: FloatArray, markers: Markers) -> FloatArray:
    """Refine corners of tags, (n, 4, 2) px, to the intersection of the edges.

    The window reaches neither the code inside the border nor the next tag's edge, which would bias the
    result.
    """
    edge = float(np.median(np.linalg.norm(np.diff(quads, axis=1), axis=-1)))
    border = markers.border_bits / _cells(markers)
    room = min(border, markers.share) if markers.share else border
    half = max(_LEAST_WINDOW, int(_OF_ROOM * room * edge))
    corners = quads.reshape(-1, 1, 2).astype(np.float32)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    cv2.cornerSubPix(image, corners, (half, half), (-1, -1), until)
    return np.asarray(corners.reshape(quads.shape), dtype=np.float64)
