"""The board's corners as a grid: spacing, orientation, and numbering."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mobilecal_cli.model import Board, Corners, FloatArray, GrayImage, IntArray


def smallest_edge_px(grid: FloatArray) -> float:
    """Shortest distance between neighboring corners of (rows, columns, 2), px."""
    along, down = grid[:, 1:] - grid[:, :-1], grid[1:] - grid[:-1]
    return float(min(np.hypot(step[..., 0], step[..., 1]).min() for step in (along, down)))


def reduced(image: GrayImage, scale: float) -> GrayImage:
    """The image at a share of its size."""
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def at_full_size(corners: FloatArray, small: GrayImage, image: GrayImage) -> FloatArray:
    """(..., 2) px of an image, from those of the same image at reduced size."""
    ratio = np.array(image.shape[::-1]) / np.array(small.shape[::-1])
    return np.asarray((corners + 0.5) * ratio - 0.5, dtype=np.float64)


def right_handed(grid: FloatArray) -> FloatArray:
    """The same corners, (rows, columns, 2), with x cross y pointing away from the camera."""
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    y = grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    return grid if x[0] * y[1] - x[1] * y[0] > 0 else grid[:, ::-1]


def turns(board: Board) -> tuple[int, ...]:
    """Quarter turns, 0 first, after which a board looks the same, including the square colors.

    Only 0 for a board with markers, or if the counts differ in parity, because opposite outer squares differ in color.
    Otherwise also a half turn; for a square board with even counts all quarter turns.
    """
    if board.markers is not None or (board.columns + board.rows) % 2:
        return (0,)
    return (0, 1, 2, 3) if board.columns == board.rows and board.columns % 2 == 0 else (0, 2)


def turned(values: FloatArray, board: Board, quarter_turns: int) -> FloatArray:
    """Corner values (M, ...) renumbered for a board rotated by one of its `turns` about its normal."""
    if quarter_turns == 0:
        return values
    grid = values.reshape(board.rows, board.columns, *values.shape[1:])
    return np.ascontiguousarray(np.rot90(grid, quarter_turns)).reshape(values.shape)


def turned_view(view: Corners, board: Board, quarter_turns: int) -> Corners:
    """The corners of an image, renumbered; see `turned`."""
    pixels, relative_cov = (turned(v, board, quarter_turns) for v in (view.pixels, view.relative_cov))
    return replace(view, pixels=pixels, relative_cov=relative_cov)


def canonical(grid: FloatArray, dark_at_origin: bool) -> tuple[IntArray, bool]:
    """Canonical order of the corners, as far as the square colors determine it.

    The outer square diagonally next to corner 0 is dark, if a rotation of the board can achieve that. Any
    remaining ambiguity (see `turns`) is resolved for now by pointing x as far to the right of the image as
    possible; `resolve_numbering` resolves it finally.

    Args:
        grid: (rows, columns, 2) right-handed, px.
        dark_at_origin: whether that square is dark in the given order.

    Returns:
        (rows * columns,) index of the given corner at each position, and whether that square is dark
        afterwards.
    """
    rows, columns = grid.shape[:2]
    order = np.arange(rows * columns).reshape(rows, columns)
    odd_square = columns == rows and columns % 2 == 1
    unambiguous = (columns + rows) % 2 == 1 or odd_square
    if not dark_at_origin and unambiguous:
        order = np.rot90(order, 1 if odd_square else 2)
    corners = grid.reshape(-1, 2)
    candidates = [np.rot90(order, k) for k in turns(Board(columns, rows))]
    best = max(candidates, key=lambda numbers: _x_direction(corners[numbers]))
    return np.ascontiguousarray(best, dtype=np.int64).ravel(), dark_at_origin or unambiguous


def _x_direction(grid: FloatArray) -> float:
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    return float(x[0] / np.linalg.norm(x))
