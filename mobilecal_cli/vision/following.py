"""Tracking of the board from image to image: by extrapolation, then by optical flow, then by a new search."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np

from mobilecal_cli.model.arrays import FloatArray, GrayImage
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.vision.acceptance import MIN_EDGE_PX, accepted, check_size, colors, fit_board
from mobilecal_cli.vision.corner_model import FittedCorners, refine
from mobilecal_cli.vision.detection import find_board, least_response, may_show_board
from mobilecal_cli.vision.grid import smallest_edge_px
from mobilecal_cli.vision.values import Appearance, Detection, Miss

_LONGEST_GAP_NS = 500_000_000  # longest time over which the board's motion is extrapolated
_AGAIN_NS = 350_000_000  # wait after a failed search, which costs as much as tracking in ten images
_MARGIN_PX = 3.0  # least distance of the predicted corners from the border
_FLOW_WINDOW = (15, 15)  # px, as usual for Lucas-Kanade
_FLOW_REACH_PX = 64  # half a flow window at the coarsest of three pyramid levels
_WEAKEST = 0.35  # least contrast of a corner, as a share of the board's in the last image
_WHOLE = 0.75  # least contrast of the outermost corners over those next to them: at the pattern's border it is a half
_FEWEST = 0.8  # least share of valid corners, over the board and along each of its sides


def follow(image: GrayImage, expected: FloatArray, appearance: Appearance, board: Board) -> Detection | Miss:
    """Detect the board near its predicted position, with the same numbering.

    Corners are refined and fitted. They are accepted if nearly all of them have the expected square colors,
    including the outermost, and if they lie on a smooth grid. In a grid that is shifted by one square, the outermost
    have other colors, or, along a diagonal, half of the contrast of those next to them.

    Args:
        image: (height, width) gray.
        expected: (M, 2) predicted corners, px.
        appearance: of the last image that showed the board.
        board: a checkerboard.
    """
    height, width = image.shape
    low, high = expected.min(axis=0), expected.max(axis=0)
    if low.min() < _MARGIN_PX or high[0] > width - 1 - _MARGIN_PX or high[1] > height - 1 - _MARGIN_PX:
        return Miss(Reason.OCCLUDED, "the predicted corners are at the image border")
    grid = expected.reshape(board.rows, board.columns, 2)
    if (small := check_size(grid)) is not None:
        return small
    grid = refine(image, grid, smallest_edge_px(grid), appearance.outer_whole, tracked=True)
    if smallest_edge_px(grid) < MIN_EDGE_PX / 2:
        return Miss(Reason.IRREGULAR, "refined corners coincide")
    fit, grid_map = fit_board(image, grid, appearance)
    if not _is_board(fit, appearance.contrast_grey, board):
        return Miss(
            Reason.COLORS,
            "corners at the predicted position are occluded or have the wrong square colors",
        )
    return accepted(fit, grid_map, appearance)


def _is_board(fit: FittedCorners, contrast_grey: float, board: Board) -> bool:
    shape = board.rows, board.columns
    strength = fit.contrast_grey.reshape(shape) * (colors(*shape) / contrast_grey)
    good = fit.fitted.reshape(shape) & (strength > _WEAKEST)
    sides = good[0], good[-1], good[:, 0], good[:, -1], good
    if any(np.count_nonzero(side) < _FEWEST * side.size for side in sides):
        return False
    lines = strength, strength[::-1], strength.T, strength.T[::-1]
    return all(np.median(outermost) > _WHOLE * np.median(next_to_it) for outermost, next_to_it, *_ in lines)


class BoardFollower:
    """Tracks the board through the images of one camera, in order of time.

    The position is extrapolated from the last two detections; after a gap of half a second the last position
    is used. If the board is not there, optical flow predicts it. Otherwise the whole image is searched. After
    the first detection, a search needs as many saddle points as the board has corners, with a tenth of their
    response. Unless it is thorough, the next search after a failed one waits; when the board is back, it is tracked
    back through the images that were not searched.

    A second board is searched for until the first detection, and in every thorough search.

    Args:
        board: board to detect; boards with markers are searched for in every image.
        thorough: see `detect`.

    Attributes:
        earlier: time → the board in earlier images, tracked back from the last image.
    """

    def __init__(self, board: Board, thorough: bool) -> None:
        self._board, self._thorough = board, thorough
        self._nothing = Miss(Reason.NO_BOARD, f"fewer than {board.corners} possible corners in the image")
        self._last_two: deque[tuple[int, Detection]] = deque(maxlen=2)
        self._last_image: GrayImage = np.zeros((0, 0), dtype=np.uint8)
        self._least_response = 0.0  # of a saddle point that may be a corner of the board
        self._lost = False
        self._failed_ns: int | None = None  # time of the last search, if it failed
        self._waited: list[tuple[int, GrayImage]] = []  # images since then that were not searched
        self.earlier: dict[int, Detection] = {}

    def find(self, image: GrayImage, time_ns: int) -> Detection | Miss:
        """Detect the board in the next image.

        Args:
            image: (height, width) gray.
            time_ns: its stamp.
        """
        self.earlier = {}
        if self._board.markers is not None:
            return find_board(image, self._board)
        if self._lost and not may_show_board(image, self._board.corners, self._least_response):
            return self._nothing
        detection = self._followed(image, time_ns)
        if not isinstance(detection, Detection):
            detection = self._searched(image, time_ns, detection)
        self._lost = not isinstance(detection, Detection)
        if isinstance(detection, Detection):
            self._remember(image, time_ns, detection)
            self._track_back()
        return detection

    def _remember(self, image: GrayImage, time_ns: int, detection: Detection) -> None:
        self._last_two.append((time_ns, detection))
        self._last_image = image

    def _track_back(self) -> None:
        """Track the board from the last image to earlier ones, which are later ones if time runs back."""
        back = BoardFollower(self._board, self._thorough)
        last_ns, last = self._last_two[-1]
        back._remember(self._last_image, -last_ns, last)
        while self._waited:
            time_ns, image = self._waited.pop()
            detection = back._followed(image, -time_ns)
            if not isinstance(detection, Detection):
                self._waited.clear()
                break
            back._remember(image, -time_ns, detection)
            self.earlier[time_ns] = detection

    def _followed(self, image: GrayImage, time_ns: int) -> Detection | Miss | None:
        """Detect the board at its predicted position; None before the first detection."""
        appearance = self._last_two[-1][1].appearance if self._last_two else None
        if appearance is None:
            return None
        detection = follow(image, self._expected(time_ns), appearance, self._board)
        soon = 0 <= time_ns - self._last_two[-1][0] <= _LONGEST_GAP_NS
        if not isinstance(detection, Detection) and soon and self._last_image.shape == image.shape:
            detection = follow(image, self._carried(image), appearance, self._board)
        return detection

    def _expected(self, time_ns: int) -> FloatArray:
        """Corners extrapolated at constant velocity; the last ones after a long gap, as robots often rest."""
        (before_ns, before), (last_ns, last) = self._last_two[0], self._last_two[-1]
        gap_ns = last_ns - before_ns
        if not (0 <= time_ns - last_ns <= _LONGEST_GAP_NS and 0 < gap_ns <= _LONGEST_GAP_NS):
            return last.pixels
        share = (time_ns - last_ns) / gap_ns
        return np.asarray(last.pixels + share * (last.pixels - before.pixels))

    def _carried(self, image: GrayImage) -> FloatArray:
        """Corners predicted by pyramidal Lucas-Kanade optical flow from the last image."""
        last = self._last_two[-1][1].pixels
        first = np.maximum(last.min(axis=0).astype(np.int64) - _FLOW_REACH_PX, 0)
        end = last.max(axis=0).astype(np.int64) + _FLOW_REACH_PX
        around = slice(first[1], end[1]), slice(first[0], end[0])
        start = (last - first).astype(np.float32).reshape(-1, 1, 2)
        moved = cv2.calcOpticalFlowPyrLK(
            self._last_image[around], image[around], start, start.copy(), winSize=_FLOW_WINDOW
        )[0]
        return np.asarray(moved.reshape(-1, 2) + first, dtype=np.float64)

    def _searched(self, image: GrayImage, time_ns: int, lost: Miss | None) -> Detection | Miss:
        """Search the whole image, after tracking failed."""
        if not self._lost and not may_show_board(image, self._board.corners, self._least_response):
            return lost or self._nothing
        since_ns = None if self._failed_ns is None else time_ns - self._failed_ns
        if since_ns is not None and not self._thorough and 0 <= since_ns < _AGAIN_NS:
            self._waited.append((time_ns, image))
            return lost or Miss(
                Reason.NO_BOARD, f"the last search, {since_ns / 1e9:.2f} s earlier, found none"
            )
        alone = not self._thorough and self._least_response > 0
        detection = find_board(image, self._board, self._thorough, alone)
        self._failed_ns = None if isinstance(detection, Detection) else time_ns
        if self._failed_ns is not None:
            self._waited.clear()
        if isinstance(detection, Detection):
            own = least_response(image, self._board.corners)
            self._least_response = min(self._least_response or own, own)
        return detection
