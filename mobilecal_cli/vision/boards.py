"""Detection of a board of any kind in one image."""

from __future__ import annotations

from mobilecal_cli.model import Board, GrayImage
from mobilecal_cli.vision.detection import detect
from mobilecal_cli.vision.markers import detect_markers
from mobilecal_cli.vision.values import Detection, Miss


def find_board(
    image: GrayImage, board: Board, thorough: bool = True, alone: bool = False
) -> Detection | Miss:
    """Detect the board in one image: see `detect` and `detect_markers`."""
    if board.markers is not None:
        return detect_markers(image, board)
    return detect(image, board.columns, board.rows, thorough, alone)
