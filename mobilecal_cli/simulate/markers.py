"""Print of a board with markers, for rendering."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import Board, FloatArray, GrayImage, Markers

_CELL_PX = 100  # pixels of the print per square (or tag)


def printed_area(board: Board) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits of x and y of the printed area, (2,) each, in squares (tags)."""
    if board.markers is None or board.markers.kind == "charuco":
        return np.array([-1.0, -1.0]), np.array([board.columns, board.rows], dtype=np.float64)
    gap, grid = board.markers.share, board.grid()[:, :2]
    return grid.min(axis=0) - gap, grid.max(axis=0) + gap


class Print:
    """Brightness of the print, from -1 (dark) to 1 (light).

    Args:
        board, markers: the board and its markers.
    """

    def __init__(self, board: Board, markers: Markers) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
        self._low, high = printed_area(board)
        width, height = np.round((high - self._low) * _CELL_PX).astype(int)
        if markers.kind == "charuco":
            squares = (board.columns + 1, board.rows + 1)
            ids = np.arange(markers.first_id, markers.first_id + squares[0] * squares[1] // 2)
            drawn = cv2.aruco.CharucoBoard(squares, 1.0, markers.share, dictionary, ids)
            image: GrayImage = np.asarray(
                drawn.generateImage((int(width), int(height)), borderBits=markers.border_bits), dtype=np.uint8
            )
        else:
            image = self._grid(board, markers, dictionary, int(width), int(height))
        self._image = image.astype(np.float32) / 127.5 - 1

    def _grid(
        self, board: Board, markers: Markers, dictionary: cv2.aruco.Dictionary, width: int, height: int
    ) -> GrayImage:
        """Grid of tags, with a dark square wherever four gaps meet, as printed by Kalibr."""
        image = np.full((height, width), 255, dtype=np.uint8)
        gap = round(markers.share * _CELL_PX)
        for tag, corner in enumerate(board.grid()[::4, :2]):
            x, y = np.round((corner - self._low) * _CELL_PX).astype(int)
            code = cv2.aruco.generateImageMarker(
                dictionary, markers.first_id + tag, _CELL_PX, borderBits=markers.border_bits
            )
            image[y : y + _CELL_PX, x : x + _CELL_PX] = code
            for left in (x - gap, x + _CELL_PX):
                for top in (y - gap, y + _CELL_PX):
                    image[top : top + gap, left : left + gap] = 0
        return image

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Brightness at positions on the board, in squares: arrays of equal shape."""
        u = ((x - self._low[0]) * _CELL_PX - 0.5).astype(np.float32)
        v = ((y - self._low[1]) * _CELL_PX - 0.5).astype(np.float32)
        value = cv2.remap(self._image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(value, dtype=np.float64)
