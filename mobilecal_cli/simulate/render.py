"""Rendered images of the board, with edges at their exact geometric position."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from mobilecal_cli.model.arrays import FloatArray, GrayImage
from mobilecal_cli.model.rig import Board, Camera, Markers
from mobilecal_cli.simulate.robot import pixels, rays

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


_SUB = 2  # subpixels per axis; edges are shaded over one, so that they are not aligned to their grid
_DARK, _LIGHT, _PAPER = 32.0, 196.0, 208.0  # gray levels
_MARGIN_SQUARES = 1.0  # of paper around the print
_PAD_PX = 6  # around the board, which the lens blur reaches
_SHADE = 0.10  # decrease of the brightness over the image width


def _width(position: FloatArray) -> FloatArray:
    """Extent of one subpixel in a board coordinate, between opposite corners."""
    rise, run = np.gradient(position)
    return np.asarray(np.abs(rise) + np.abs(run) + 1e-12)


def _edge_wave(position: FloatArray, width: FloatArray) -> FloatArray:
    """Square wave that changes sign at whole numbers, +1 from 0 to 1, with edges shaded over one subpixel."""
    nearest = np.round(position)
    sign = np.where(nearest % 2 == 0, 1.0, -1.0)
    return np.asarray(sign * np.clip(2 * (position - nearest) / width, -1, 1))


def _covered(position: FloatArray, width: FloatArray, low: float, high: float) -> FloatArray:
    """Share of a subpixel between two lines of the board."""
    above = np.clip((position - low) / width + 0.5, 0, 1)
    return np.asarray(above * np.clip((high - position) / width + 0.5, 0, 1))


def pixel_grid(camera: Camera) -> FloatArray:
    """Every pixel of a camera, (height, width, 2) px."""
    x, y = (np.arange(n, dtype=np.float64) for n in (camera.width, camera.height))
    return np.stack(np.meshgrid(x, y), -1)


@lru_cache(maxsize=4)
def _pixel_rays(camera: Camera) -> FloatArray:
    """Ray of each pixel of a camera, (height, width, 2) at z = 1: slower than drawing an image."""
    return rays(camera, pixel_grid(camera))


class BoardRenderer:
    """Renders one board in one camera's images.

    Args:
        camera: pinhole, with plumb_bob distortion or none.
        board: with known square size.
        blur_px: sigma of the lens blur, px.
        random: for the background.
    """

    def __init__(self, camera: Camera, board: Board, blur_px: float, random: np.random.Generator) -> None:
        self.camera, self.board, self._blur_px = camera, board, blur_px
        height, width = camera.height, camera.width
        # Rays change direction by 0.0002 px between two pixels, so linear interpolation is exact enough for
        # subpixels.
        fine = (width * _SUB, height * _SUB)
        self._rays = np.asarray(
            cv2.resize(self.pixel_rays(), fine, interpolation=cv2.INTER_LINEAR),
            dtype=np.float64,
        )
        self._light = 1 - _SHADE * np.linspace(0, 1, width)[None, :] * np.linspace(1, 0.6, height)[:, None]
        self._background = self._clutter(random)
        self._print = None if board.markers is None else Print(board, board.markers)
        self._last = (np.zeros((0, 0)), np.zeros((0, 0)))

    def pixel_rays(self) -> FloatArray:
        """Ray of each pixel, (height, width, 2) at z = 1."""
        return _pixel_rays(self.camera)

    def pixels_of(self, T_x_k: FloatArray, at: FloatArray) -> FloatArray:
        """Pixels (N, 2) of places on the board, (N, 2) squares."""
        points_k = np.column_stack([at * (self.board.square_m or 1.0), np.zeros(len(at))])
        return pixels(self.camera, points_k @ T_x_k[:3, :3].T + T_x_k[:3, 3])

    def on_board(self, T_x_k: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where rays (..., 2) meet the board: x and y, squares."""
        normal, origin = T_x_k[:3, 2], T_x_k[:3, 3]
        depth = (normal @ origin) / (rays @ normal[:2] + normal[2])
        columns = np.moveaxis(T_x_k[:3, :2] / (self.board.square_m or 1.0), 1, 0)
        x, y = (depth * (rays @ column[:2] + column[2]) - origin @ column for column in columns)
        return x, y

    def _clutter(self, random: np.random.Generator) -> FloatArray:
        """Background: a wall with blurred boxes and stripes."""
        height, width = self.camera.height, self.camera.width
        wall = np.full((height, width), 120.0)
        for _ in range(14):
            x, y = random.integers(0, width), random.integers(0, height)
            w, h = random.integers(20, 160), random.integers(20, 120)
            wall[y : y + h, x : x + w] = random.uniform(60, 180)
        return np.asarray(cv2.GaussianBlur(wall, (0, 0), 3.0), dtype=np.float64)

    def picture(self, T_x_k: FloatArray) -> FloatArray:
        """Noise-free image (height, width), in gray levels, of a board at T_x_k in the camera frame.

        Consecutive calls with the same pose, as in a rest, return the same array: do not modify it.
        """
        if not np.array_equal(self._last[0], T_x_k):
            self._last = (T_x_k, self._drawn(T_x_k))
        return self._last[1]

    def _drawn(self, T_x_k: FloatArray) -> FloatArray:
        image = self._background.copy()
        low, high = printed_area(self.board)
        wide = np.linspace(low - _MARGIN_SQUARES, high + _MARGIN_SQUARES, 12)
        outline = np.array([[x, y] for x in wide[:, 0] for y in wide[:, 1]])
        at = self.pixels_of(T_x_k, outline)
        limit = [self.camera.width, self.camera.height]
        x0, y0 = np.clip(np.floor(at.min(axis=0)).astype(int) - _PAD_PX, 0, limit)
        x1, y1 = np.clip(np.ceil(at.max(axis=0)).astype(int) + _PAD_PX, 0, limit)
        if x1 > x0 and y1 > y0:
            part = self._rays[y0 * _SUB : y1 * _SUB, x0 * _SUB : x1 * _SUB]
            x, y = self.on_board(T_x_k, part)
            wide_x, wide_y = _width(x), _width(y)
            middle, swing = (_DARK + _LIGHT) / 2, (_LIGHT - _DARK) / 2
            if self._print is None:
                # The square outside corner 0 (-1 to 0 on both axes) is dark.
                pattern = middle - swing * _edge_wave(x, wide_x) * _edge_wave(y, wide_y)
            else:
                pattern = middle + swing * self._print.at(x, y)
            on_pattern = _covered(x, wide_x, low[0], high[0]) * _covered(y, wide_y, low[1], high[1])
            on_paper = _covered(x, wide_x, low[0] - _MARGIN_SQUARES, high[0] + _MARGIN_SQUARES)
            on_paper *= _covered(y, wide_y, low[1] - _MARGIN_SQUARES, high[1] + _MARGIN_SQUARES)
            behind = np.repeat(np.repeat(image[y0:y1, x0:x1], _SUB, axis=0), _SUB, axis=1)
            fine = on_paper * (on_pattern * pattern + (1 - on_pattern) * _PAPER) + (1 - on_paper) * behind
            # Blur before sampling, as a lens does: otherwise edges would shift with their position inside a
            # pixel.
            blurred = cv2.GaussianBlur(fine, (0, 0), self._blur_px * _SUB, borderType=cv2.BORDER_REPLICATE)
            image[y0:y1, x0:x1] = blurred.reshape(y1 - y0, _SUB, x1 - x0, _SUB).mean(axis=(1, 3))
        return np.asarray(image * self._light)
