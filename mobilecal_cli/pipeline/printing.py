"""`mobilecal board`: a board to print."""

from __future__ import annotations

from mobilecal_cli.config import load_rig
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export import BoardPrint, board_pdf
from mobilecal_cli.pipeline.extracting import board_of
from mobilecal_cli.targets import Paper

_FAMILIES = (50, 100, 250, 1000)


def print_board(
    columns: int,
    rows: int,
    square_m: float,
    charuco: bool = False,
    dictionary: str | None = None,
    marker_share: float | None = None,
    paper: Paper = Paper.auto,
) -> BoardPrint:
    """A board as a PDF at true scale.

    Args:
        columns, rows: inner corners.
        square_m: side of a square, m.
        charuco: with markers in the light squares.
        dictionary: marker family by its OpenCV name; the smallest sufficient one of 5 x 5 cells by default.
        marker_share: marker side over square side; 0.75 by default.
        paper: page.

    Raises:
        ConfigError: a value is out of range, or the board does not fit on the page.
    """
    flags: dict[str, object] = {
        "board.kind": "charuco" if charuco else "checkerboard",
        "board.columns": columns,
        "board.rows": rows,
        "board.square_m": square_m,
        "board.dictionary": dictionary,
        "board.marker_share": marker_share,
    }
    if charuco:
        flags["board.dictionary"] = dictionary or _smallest((columns + 1) * (rows + 1) // 2)
        flags["board.marker_share"] = 0.75 if marker_share is None else marker_share
    elif dictionary is not None or marker_share is not None:
        raise ConfigError("--dictionary and --marker-share apply only to ChArUco boards", "add --charuco")
    board = board_of(load_rig(None, flags))
    assert board is not None
    return board_pdf(board, paper)


def _smallest(markers: int) -> str:
    """The dictionary of 5 x 5 cells with enough markers: small ones have fewer false detections."""
    return f"DICT_5X5_{next((size for size in _FAMILIES if size >= markers), _FAMILIES[-1])}"
