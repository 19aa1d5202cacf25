"""Boards to print at true scale, as a PDF of one page."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.text import decimal
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import Board, Markers
from mobilecal_cli.targets import Paper

_CHARACTER = 0.6  # width of a character of Courier, in shares of its size
_POINTS_PER_MM = 72 / 25.4  # a point is 1/72 inch
_LARGEST_MM = 14_400 / _POINTS_PER_MM  # side of a page: 14,400 points are the limit of PDF


def one_page(
    size_mm: tuple[float, float],
    rectangles_mm: FloatArray,
    lines: Sequence[tuple[str, float, float]],
    title: str,
) -> bytes:
    """A PDF of one page. It asks the reader to print without scaling.

    Args:
        size_mm: width and height of the page, at most `_LARGEST_MM`.
        rectangles_mm: (n, 4) x and y of the top left corner from that of the page, width and height. They are filled
            in black as one path, so that adjacent ones have no seam.
        lines: ASCII text in Courier, and x and y of the start of its baseline from the top left corner, mm.
        title: title of the document, ASCII.
    """
    scale, (width, height) = _number(_POINTS_PER_MM), (_number(side * _POINTS_PER_MM) for side in size_mm)
    drawing = [f"{scale} 0 0 -{scale} 0 {height} cm"]  # y down
    drawing += [" ".join(_number(value) for value in row) + " re" for row in rectangles_mm]
    drawing += ["f", "BT"]
    for text, x_mm, y_mm in lines:
        place = f"1 0 0 -1 {_number(x_mm)} {_number(y_mm)} Tm"
        drawing.append(f"/F {_number(_TEXT_MM)} Tf {place} {_text(text)} Tj")
    content = "\n".join([*drawing, "ET"]).encode("ascii")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Courier /Encoding /WinAnsiEncoding >>",
        f"<< /Title {_text(title)} /Producer (mobilecal) >>".encode("ascii"),
    ]
    # Header, numbered objects, table of their positions, trailer; the first is the catalog, the last the info.
    out = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n")  # bytes above 127: not a text file
    positions = []
    for number, body in enumerate(objects, 1):
        positions.append(len(out))
        out += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table, count = len(out), len(objects) + 1
    out += b"xref\n0 %d\n0000000000 65535 f \n" % count
    out += b"".join(b"%010d 00000 n \n" % position for position in positions)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (count, len(objects))
    return bytes(out + b"startxref\n%d\n%%%%EOF\n" % table)


def _number(value: float) -> str:
    """Up to six decimals, without an exponent, which PDF does not have."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


def _text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    return f"({escaped})"


#: Page size in portrait, mm.
_PAGES_MM = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
    "ansi_c": (431.8, 558.8),
    "ansi_d": (558.8, 863.6),
    "ansi_e": (863.6, 1117.6),
}
_AUTOMATIC = ("a4", "a3", "a2", "a1", "a0")
_MARGIN_MM = 8.0  # white around the board, and what printers leave blank
_GAP_MM = 6.0  # above and below the text
_TEXT_MM, _PITCH_MM = 2.5, 3.2
_BAR_MM, _TICK_MM = 1.0, 3.0
_BARS_MM = (1000.0, 500.0, 200.0, 100.0, 50.0)
_NARROWEST_MM = 120.0  # of a page, for the text


@dataclass(frozen=True, slots=True)
class BoardPrint:
    """A board to print.

    Attributes:
        content: the PDF.
        page: the page, for people.
        config: the line for rig.yaml.
        border_mm: white around the board, at its narrowest side on the page, mm.
    """

    content: bytes
    page: str
    config: str
    border_mm: float


def board_pdf(board: Board, paper: Paper) -> BoardPrint:
    """A board at true scale, with a scale bar, its size in words, and the line for rig.yaml.

    The board is in the middle of the page, and the text is below it. The first square at the top left is dark.

    Args:
        board: a checkerboard or ChArUco board with `square_m`.
        paper: page; portrait or landscape, as the board fits.

    Raises:
        ConfigError: the board does not fit on the page, or the dictionary has too few markers.
    """
    assert board.square_m is not None
    square_mm, board_mm = board.square_m * 1e3, _size_mm(board)
    page, (width, height) = _page(board, paper)
    config = board_setting(board)
    # The longest scale bar that leaves place for its label.
    bar_mm = next(bar for bar in _BARS_MM if bar <= width - 2 * _MARGIN_MM - 20)
    words = _words(board, page, bar_mm)
    left, spare = (width - board_mm[0]) / 2, height - _needed(board, width)[1]
    top = _MARGIN_MM + spare / 2
    low = dark_squares(board, 1.0)[:, 0, :2] + 1
    dark = np.hstack([low, np.ones_like(low)])
    if board.markers is not None:
        dark = np.vstack([dark, _cells(board.columns + 1, board.rows + 1, board.markers)])
    rectangles = dark * square_mm + np.array([left, top, 0.0, 0.0])
    baseline = top + board_mm[1] + _GAP_MM + spare / 2
    # The scale bar is a line with a tick inside each end, so that the outer edges are its length apart.
    bar = [
        [_MARGIN_MM, baseline + _TICK_MM - _BAR_MM, bar_mm, _BAR_MM],
        [_MARGIN_MM, baseline, 0.3, _TICK_MM],
        [_MARGIN_MM + bar_mm - 0.3, baseline, 0.3, _TICK_MM],
    ]
    lines = [(f"{bar_mm:g} mm", _MARGIN_MM + bar_mm + 2, baseline + _TICK_MM)]
    lines += [
        (text, _MARGIN_MM, baseline + _TICK_MM + (number + 1.2) * _PITCH_MM)
        for number, text in enumerate(_wrapped([*words, config], width))
    ]
    content = one_page((width, height), np.vstack([rectangles, bar]), lines, f"{words[0]} mobilecal")
    return BoardPrint(content, page, config, min(left, top))


def dark_squares(board: Board, square_m: float) -> FloatArray:
    """(n, 4, 3) corners of the dark squares (aprilgrid: of the tags) in the board's frame, m."""
    if board.markers is not None and board.markers.kind == "aprilgrid":
        return np.asarray(board.grid().reshape(-1, 4, 3) * square_m)
    row, column = np.divmod(np.arange((board.columns + 1) * (board.rows + 1)), board.columns + 1)
    dark = (row + column) % 2 == 0
    low = np.stack([column[dark] - 1, row[dark] - 1, np.zeros(int(dark.sum()))], axis=1)
    return np.asarray((low[:, None] + np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])) * square_m)


def board_setting(board: Board) -> str:
    """The line of rig.yaml that describes a board."""
    square = decimal(board.square_m or 0.0)
    size = f"columns: {board.columns}, rows: {board.rows}, square_m: {square}"
    markers = board.markers
    if markers is None:
        return f"board: {{{size}}}"
    return (
        f"board: {{kind: charuco, {size}, dictionary: {markers.dictionary}, "
        f"marker_share: {decimal(markers.share)}}}"
    )


def _size_mm(board: Board) -> tuple[float, float]:
    """Width and height of a board with `square_m`."""
    square_mm = (board.square_m or 0.0) * 1e3
    return (board.columns + 1) * square_mm, (board.rows + 1) * square_mm


def _words(board: Board, page: str, bar_mm: float) -> list[str]:
    """What the page shows, and how to print and check it."""
    square_mm, board_mm = (board.square_m or 0.0) * 1e3, _size_mm(board)
    size = f"{board.columns} x {board.rows} inner corners, squares of {square_mm:g} mm"
    if board.markers is None:
        what = f"Checkerboard, {size}."
    else:
        side = f"markers of {board.markers.share * square_mm:g} mm ({board.markers.dictionary})"
        what = f"ChArUco board, {size}, {side}."
    whole = f"{board_mm[0]:g} mm x {board_mm[1]:g} mm"
    return [
        what,
        f"Print at actual size (100 %) on {page}. Check with a ruler: the bar is {bar_mm:g} mm long, the board "
        f"{whole}.",
    ]


def _wrapped(texts: list[str], page_width_mm: float) -> list[str]:
    width = int((page_width_mm - 2 * _MARGIN_MM) / (_CHARACTER * _TEXT_MM))
    return [line for text in texts for line in textwrap.wrap(text, width)]


def _needed(board: Board, page_width_mm: float) -> tuple[float, float]:
    """Width and height that a page of some width needs, mm."""
    board_mm = _size_mm(board)
    width = max(board_mm[0] + 2 * _MARGIN_MM, _NARROWEST_MM)
    page_width_mm = max(page_width_mm, width)
    longest = _words(board, "tabloid (0000.0 x 0000.0 mm)", 1000.0)
    count = len(_wrapped([*longest, board_setting(board)], page_width_mm))
    height = board_mm[1] + _MARGIN_MM + _GAP_MM + _TICK_MM + (count + 0.2) * _PITCH_MM + _GAP_MM
    return float(np.ceil(width)), float(np.ceil(height))


def _page(board: Board, paper: Paper) -> tuple[str, tuple[float, float]]:
    """Description and size (mm) of the page to use, portrait or landscape."""
    if paper == "exact":
        size = _needed(board, 0.0)
        if max(size) > _LARGEST_MM:
            raise ConfigError(
                f"the board needs a page of {size[0]:.0f} x {size[1]:.0f} mm (limit of a PDF: {_LARGEST_MM:.0f} mm)",
                "use smaller or fewer squares",
            )
        return f"a page of {size[0]:g} x {size[1]:g} mm", size
    fitting = {
        name: size
        for name, portrait in _PAGES_MM.items()
        for size in (portrait[::-1], portrait)  # portrait if both fit
        if np.all(np.array(_needed(board, size[0])) <= size)
    }
    names = _AUTOMATIC if paper == "auto" else (paper,)
    for name in names:
        if name in fitting:
            width, height = fitting[name]
            shown = name.upper() if name in _AUTOMATIC else name
            return f"{shown} ({width:g} x {height:g} mm)", (width, height)
    if not fitting:
        _page(board, "exact")  # refuses what fits on no page
    largest, larger = names[-1], next(iter(fitting), "exact")
    (width, height), board_mm = _PAGES_MM[largest], _size_mm(board)
    raise ConfigError(
        f"the board of {board_mm[0]:g} x {board_mm[1]:g} mm does not fit on {largest} "
        f"({width:g} x {height:g} mm) with {_MARGIN_MM:g} mm around it and the text below",
        f"use --paper {larger}, or smaller squares",
    )


def _cells(columns: int, rows: int, markers: Markers) -> FloatArray:
    """Dark cells of the markers in the light squares, as OpenCV arranges them.

    Returns:
        (n, 4) x, y, width, height in squares, from the top left corner of the board.
    """
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
    count = columns * rows // 2
    if markers.first_id + count > len(family.bytesList):
        raise ConfigError(
            f"the board needs {count} markers, and {markers.dictionary} has {len(family.bytesList)}",
            "choose a larger dictionary of the same family",
        )
    ids = np.arange(markers.first_id, markers.first_id + count)
    drawn = cv2.aruco.CharucoBoard((columns, rows), 1.0, markers.share, family, ids)
    corners = np.array([np.asarray(points)[0, :2] for points in drawn.getObjPoints()], dtype=np.float64)
    rectangles = []
    cells = family.markerSize + 2 * markers.border_bits
    side = markers.share / cells
    for number, (left, top) in zip(ids, corners, strict=True):
        code = cv2.aruco.generateImageMarker(family, int(number), cells, borderBits=markers.border_bits)
        for y, line in enumerate(np.asarray(code) == 0):
            edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
            for start, end in edges.reshape(-1, 2):
                rectangles.append((left + start * side, top + y * side, (end - start) * side, side))
    return np.array(rectangles)
