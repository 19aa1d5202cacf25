"""Tracking of the board from image to image: by extrapolation, then by optical flow, then by a new search."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from mobilecal_cli.model import Board, FloatArray, GrayImage
from mobilecal_cli.vision.acceptance import MIN_EDGE_PX, check_grid, check_size, fit_board
from mobilecal_cli.vision.corner_model import FittedCorners
from mobilecal_cli.vision.detection import FAINTEST, find_board
from mobilecal_cli.vision.gate import MAX_EDGE_WIDTH
from mobilecal_cli.vision.grid import smallest_edge_px
from mobilecal_cli.vision.refinement import refine_once
from mobilecal_cli.vision.saddles import has_saddle_points, saddle_response
from mobilecal_cli.vision.values import FLOOR_PX, Appearance, Detection, Miss

_LONGEST_GAP_NS = 500_000_000  # longest time over which the board's motion is extrapolated
# A search costs as much as tracking in ten images. After a failed search the next one waits for the first of
# these times, then for twice as long, up to the second.
_AGAIN_NS, _AGAIN_AT_LAST_NS = 350_000_000, 1_400_000_000
_MARGIN_PX = 3.0
_MORE = 1.5  # a board that enters the view multiplies the saddle response by at least this factor
_FLOW_WINDOW = (15, 15)
_FLOW_REACH_PX = 64  # half a flow window at the coarsest of three pyramid levels
_WEAKEST = 0.35  # least contrast of a corner, as a share of the board's in the last image
_FEWEST = 0.8  # least share of valid corners, over the board and along each of its sides


def follow(
    image: GrayImage, expected: FloatArray, appearance: Appearance, columns: int, rows: int
) -> Detection | Miss:
    """Detect the board near its predicted position, with the same numbering.

    Corners are refined and fitted. They are accepted if nearly all of them have the expected square colors,
    including the outermost (a grid shifted by one square would fail there), and if they lie on a smooth grid.

    Args:
        image: (height, width) gray.
        expected: (M, 2) predicted corners, px.
        appearance: of the last image that showed the board.
        columns, rows: inner corners.
    """
    height, width = image.shape
    low, high = expected.min(axis=0), expected.max(axis=0)
    if low.min() < _MARGIN_PX or high[0] > width - 1 - _MARGIN_PX or high[1] > height - 1 - _MARGIN_PX:
        return Miss(
            "board partly occluded or outside the image", "the predicted corners are at the image border"
        )
    grid = expected.reshape(rows, columns, 2)
    if (small := check_size(grid)) is not None:
        return small
    edge = smallest_edge_px(grid)
    grid = refine_once(image, expected, edge, appearance.outer_whole).reshape(grid.shape)
    if smallest_edge_px(grid) < MIN_EDGE_PX / 2:
        return Miss("corners not on a regular grid", "refined corners coincide")
    fit, grid_map = fit_board(image, grid, appearance.outer_whole, appearance)
    width_squares = 2.563 * fit.blur_px / edge
    if width_squares > MAX_EDGE_WIDTH:
        return Miss(
            "blurred", f"borders are {width_squares:.2f} squares wide (10 to 90 %), limit {MAX_EDGE_WIDTH}"
        )
    if not _is_board(fit, appearance.contrast_grey, rows, columns):
        return Miss(
            "square colors do not alternate",
            "corners at the predicted position are occluded or have the wrong square colors",
        )
    if (rough := check_grid(fit, grid_map)) is not None:
        return rough
    contrast = np.copysign(fit.half_contrast_grey, appearance.contrast_grey)
    seen = Appearance(fit.blur_px, fit.noise_grey, float(contrast), appearance.outer_whole)
    return Detection(fit.pixels, max(grid_map.sigma_px, FLOOR_PX), cov=fit.cov, appearance=seen)


@lru_cache(maxsize=16)
def _colours(rows: int, columns: int) -> FloatArray:
    """1 and -1 in a checkerboard pattern, (rows, columns)."""
    j, i = np.indices((rows, columns))
    return np.where((i + j) % 2 == 0, 1.0, -1.0)


def _is_board(fit: FittedCorners, contrast_grey: float, rows: int, columns: int) -> bool:
    strength = fit.contrast_grey.reshape(rows, columns) * (_colours(rows, columns) / contrast_grey)
    good = fit.fitted.reshape(rows, columns) & (strength > _WEAKEST)
    sides = good[0], good[-1], good[:, 0], good[:, -1], good
    return all(np.count_nonzero(side) >= _FEWEST * side.size for side in sides)


@dataclass(frozen=True, slots=True)
class _Vain:
    """The last search, if it failed.

    Attributes:
        time_ns: stamp of its image.
        wait_ns: time until the next search.
        strength: saddle response of its image.
    """

    time_ns: int
    wait_ns: int
    strength: float


class BoardFollower:
    """Tracks the board through the images of one camera, in order of time.

    The position is extrapolated from the last two detections; after a gap of half a second the last position
    is used. If the board is not there, optical flow predicts it. Otherwise the whole image is searched. After
    the first detection, a search needs as many saddle points as the board has corners, with a tenth of their
    response. After a failed search, the next one waits, unless the saddle response has increased strongly.

    A second board is searched for until the first detection, and in every thorough search.

    Args:
        board: board to detect; boards with markers are searched for in every image.
        thorough: see `detect`.
    """

    def __init__(self, board: Board, thorough: bool) -> None:
        self._board, self._thorough = board, thorough
        self._seen: deque[tuple[int, Detection]] = deque(maxlen=2)
        self._last_image: GrayImage = np.zeros((0, 0), dtype=np.uint8)
        self._response: float | None = None
        self._lost = False
        self._vain: _Vain | None = None  # None after a detection

    def find(self, image: GrayImage, time_ns: int) -> Detection | Miss:
        """Detect the board in the next image.

        Args:
            image: (height, width) gray.
            time_ns: its stamp.
        """
        if self._board.markers is not None:
            return find_board(image, self._board)
        if self._lost and not self._enough_saddle_points(image):
            return self._nothing()
        found = self._followed(image, time_ns)
        if not isinstance(found, Detection):
            found = self._searched(image, time_ns, found)
        self._lost = not isinstance(found, Detection)
        if isinstance(found, Detection):
            self._seen.append((time_ns, found))
            self._last_image, self._vain = image, None
        return found

    def _followed(self, image: GrayImage, time_ns: int) -> Detection | Miss | None:
        """Detect the board at its predicted position; None before the first detection."""
        appearance = self._seen[-1][1].appearance if self._seen else None
        if appearance is None:
            return None
        columns, rows = self._board.columns, self._board.rows
        found = follow(image, self._expected(time_ns), appearance, columns, rows)
        soon = 0 <= time_ns - self._seen[-1][0] <= _LONGEST_GAP_NS
        if not isinstance(found, Detection) and soon and self._last_image.shape == image.shape:
            found = follow(image, self._carried(image), appearance, columns, rows)
        return found

    def _expected(self, time_ns: int) -> FloatArray:
        """Corners extrapolated at constant velocity; the last ones after a long gap, as robots often rest."""
        last_ns, last = self._seen[-1]
        if not 0 <= time_ns - last_ns <= _LONGEST_GAP_NS:
            return last.pixels
        if len(self._seen) < 2 or last_ns - self._seen[0][0] > _LONGEST_GAP_NS:
            return last.pixels
        before_ns, before = self._seen[0]
        share = (time_ns - last_ns) / max(last_ns - before_ns, 1)
        return np.asarray(last.pixels + share * (last.pixels - before.pixels))

    def _carried(self, image: GrayImage) -> FloatArray:
        """Corners predicted by pyramidal Lucas-Kanade optical flow from the last image."""
        last = self._seen[-1][1].pixels
        first = np.maximum(last.min(axis=0).astype(np.int64) - _FLOW_REACH_PX, 0)
        end = last.max(axis=0).astype(np.int64) + _FLOW_REACH_PX
        around = slice(first[1], end[1]), slice(first[0], end[0])
        start = (last - first).astype(np.float32).reshape(-1, 1, 2)
        moved = cv2.calcOpticalFlowPyrLK(
            self._last_image[around], image[around], start, start.copy(), winSize=_FLOW_WINDOW
        )[0]
        return np.asarray(moved.reshape(-1, 2) + first, dtype=np.float64)

    def _enough_saddle_points(self, image: GrayImage) -> bool:
        """Whether enough saddle points have the least response known from the board's corners."""
        return self._response is None or has_saddle_points(
            image, self._board.corners, FAINTEST * self._response
        )

    def _nothing(self) -> Miss:
        return Miss("no board found", f"fewer than {self._board.corners} possible corners in the image")

    def _too_soon(self, image: GrayImage, time_ns: int, vain: _Vain) -> bool:
        """Whether the waiting time after a failed search still runs."""
        waiting = 0 <= time_ns - vain.time_ns < vain.wait_ns
        return waiting and not has_saddle_points(image, self._board.corners, _MORE * vain.strength)

    def _searched(self, image: GrayImage, time_ns: int, lost: Miss | None) -> Detection | Miss:
        """Search the whole image, after tracking failed."""
        if not self._lost and not self._enough_saddle_points(image):
            return lost or self._nothing()
        vain = self._vain
        if vain is not None and not self._thorough and self._too_soon(image, time_ns, vain):
            return lost or Miss(
                "no board found",
                f"the last search, {(time_ns - vain.time_ns) / 1e9:.2f} s earlier, found none",
            )
        found = find_board(
            image, self._board, self._thorough, alone=not self._thorough and self._response is not None
        )
        strength = saddle_response(image, self._board.corners)
        if not isinstance(found, Detection):
            wait_ns = _AGAIN_NS if vain is None else min(2 * vain.wait_ns, _AGAIN_AT_LAST_NS)
            self._vain = _Vain(time_ns, wait_ns, strength)
            return found
        self._response = strength if self._response is None else min(self._response, strength)
        return found
