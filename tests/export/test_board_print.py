"""Printed boards, rendered by PDFium: their size on the page, and whether detectors find them."""

from functools import cache
from itertools import product

import cv2
import numpy as np
import pypdfium2
import pytest

from mobilecal_cli.commands.board import board
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.board_print import board_pdf
from mobilecal_cli.files.reading import load_yaml
from mobilecal_cli.model.rig import Board, Markers
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.vision import Detection, find_board

MM = 25.4
CHARUCO = Markers("charuco", "DICT_5X5_50", 0.75)
PRINTS = {
    "checkerboard": (Board(9, 6, 0.02), "auto"),
    "charuco": (Board(8, 5, 0.025, CHARUCO), "a4"),
    "charuco with an even number of rows": (
        Board(5, 7, 0.03, Markers("charuco", "DICT_4X4_100", 0.6)),
        "letter",
    ),
    "page as large as the board": (Board(4, 3, 0.05), "exact"),
    "little space around the board": (Board(8, 6, 0.08), "a1"),
}


def page_of(pdf):
    return pypdfium2.PdfDocument(pdf)[0]


def rendered(pdf, dpi):
    """Gray image of the page, and pixels per mm along x and y: PDFium stretches a page to whole pixels."""
    page = page_of(pdf)
    image = np.asarray(page.render(scale=dpi / 72, grayscale=True).to_numpy())
    image = image.reshape(image.shape[:2])
    return image, np.array(image.shape[::-1]) / page.get_size() * 72 / MM


@cache
def found_in_print(name):
    """The board, its image, pixels per mm, and where it is found."""
    board, paper = PRINTS[name]
    image, per_mm = rendered(board_pdf(board, paper).content, 150 if board.square_m < 0.06 else 75)
    return board, image, per_mm, find_board(image, board)


def opencv_corners(image, board):
    """The board's corners as OpenCV finds them, (M, 2) px, (0, 0) the center of the first pixel."""
    if board.markers is None:
        found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows))
        assert found
        return np.asarray(corners, dtype=float).reshape(-1, 2)
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.markers.dictionary))
    drawn = cv2.aruco.CharucoBoard((board.columns + 1, board.rows + 1), 1.0, board.markers.share, family)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(drawn).detectBoard(image)
    assert numbers.ravel().tolist() == list(range(board.corners))
    return np.asarray(corners, dtype=float).reshape(-1, 2)


def grid_mm(board):
    return board.grid()[:, :2] * board.square_m * 1e3


@pytest.mark.parametrize("name", PRINTS)
def test_corners_are_at_true_scale(name):
    """Both detectors find every corner, as far from the others as the board says: within 0.05 mm."""
    board, image, per_mm, ours = found_in_print(name)
    assert isinstance(ours, Detection)
    assert ours.seen.all()
    for corners in (ours.pixels, opencv_corners(image, board)):
        found = corners / per_mm
        expected = grid_mm(board) + (found - grid_mm(board)).mean(axis=0)
        if np.abs(found - expected).max() > 1:  # OpenCV may number a checkerboard from its other end
            found = found[::-1]
            expected = grid_mm(board) + (found - grid_mm(board)).mean(axis=0)
        assert np.abs(found - expected).max() < 0.05


@pytest.mark.parametrize("name", PRINTS)
def test_the_first_square_at_the_top_left_is_dark(name):
    """Every square has its color, at the place that the detected corners give it, on white paper."""
    board, image, _, found = found_in_print(name)
    corners = found.pixels
    looks_the_same_upside_down = board.markers is None and (board.columns + board.rows) % 2 == 0
    if not looks_the_same_upside_down:
        assert corners[0].tolist() == pytest.approx(corners.min(axis=0).tolist(), abs=1)
    H, _ = cv2.findHomography(board.grid()[:, :2], corners[np.lexsort(np.round(corners / 10).T)])
    rows, columns = np.meshgrid(
        np.arange(-2, board.rows + 1), np.arange(-2, board.columns + 1), indexing="ij"
    )
    inside = (rows >= -1) & (rows < board.rows) & (columns >= -1) & (columns < board.columns)
    for x, y in product((0.06, 0.94), repeat=2):  # beside the markers of light squares
        places = np.stack([columns + x, rows + y], axis=-1).reshape(1, -1, 2)
        u, v = np.round(cv2.perspectiveTransform(places, H)[0]).astype(int).T
        within = (u >= 0) & (u < image.shape[1]) & (v >= 0) & (v < image.shape[0])
        dark = image[v[within], u[within]] < 128
        expected = inside & ((rows + columns) % 2 == 0)
        assert dark.tolist() == expected.ravel()[within].tolist()


@pytest.mark.parametrize("name", PRINTS)
def test_the_bar_and_the_texts_state_the_board(name):
    board, paper = PRINTS[name]
    made, square_mm = board_pdf(board, paper), board.square_m * 1e3
    text = page_of(made.content).get_textpage().get_text_bounded()
    bar_mm = float(text.split("the bar is ")[1].split(" mm")[0])
    image, per_mm = rendered(made.content, 300 if board.square_m < 0.06 else 150)
    last = find_board(image, board).pixels[:, 1].max()
    runs = [longest_run(line) for line in image[int(last + 1.05 * square_mm * per_mm[1]) :] < 128]
    assert max(runs) / per_mm[0] == pytest.approx(bar_mm, abs=1.5 / per_mm[0])
    page_mm = np.array(page_of(made.content).get_size()) / 72 * MM
    assert (
        f"board {(board.columns + 1) * square_mm:g} mm x {(board.rows + 1) * square_mm:g} mm"
        in text.replace("\r\n", " ")
    )
    assert f"squares of {square_mm:g} mm" in text
    assert f"({page_mm[0]:g} x {page_mm[1]:g} mm)" in made.page.replace("a page of ", "(") + ")"
    flags = {f"board.{key}": value for key, value in load_yaml(made.config)["board"].items()}
    assert load_rig(None, flags).board.stated == board
    assert made.config in text.replace("\r\n", " ")


def longest_run(line):
    edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
    return max((edges[1::2] - edges[::2]).tolist(), default=0)


def test_the_file():
    made = board_pdf(*PRINTS["checkerboard"])
    assert b"/PrintScaling /None" in made.content
    document = pypdfium2.PdfDocument(made.content)
    assert document.get_metadata_dict()["Title"].startswith("Checkerboard, 9 x 6 inner corners")
    assert len(document) == 1


def test_the_default_dictionary_is_large_enough(tmp_path, capsys):
    for number, (corners, square, dictionary) in enumerate(
        [("8x5", 0.02, "DICT_5X5_50,"), ("14x14", 0.015, "DICT_5X5_250,")]
    ):
        board(corners, square, charuco=True, output=tmp_path / f"{number}.pdf")
        assert dictionary in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message", "hint"),
    [
        (("9x6", 0.03, False, None, None, "a4"), r"300 x 210 mm does not fit on a4", "--paper a3"),
        (("9x6", 0.2), r"2000 x 1400 mm does not fit on a0", "--paper exact"),
        (("50x50", 0.2, False, None, None, "exact"), r"limit of a PDF: 5080 mm", "smaller or fewer"),
        (("100x100", 0.08), r"limit of a PDF: 5080 mm", "smaller or fewer"),
        (("9x8", 0.02, True, "DICT_4X4_50"), None, None),
        (("11x8", 0.02, True, "DICT_4X4_50"), r"needs 54 markers, and DICT_4X4_50 has 50", "larger dictionary"),
        (("8x5", 0.02, False, "DICT_4X4_50"), r"apply only to ChArUco", "--charuco"),
        (("8x5", 0.02, True, "DICT_9X9"), r"board\.dictionary", ""),
        (("2x5", 0.02), r"3 or more", ""),
        (("8x5", -0.02), r"square_m", ""),
        (("8x5", 0.02, True, None, 1.2), r"marker_share", ""),
    ],
)  # fmt: skip
def test_refusals(arguments, message, hint, tmp_path):
    output = tmp_path / "board.pdf"
    if message is None:
        board(*arguments, output=output)
        assert output.is_file()
        return
    with pytest.raises(ConfigError, match=message) as refused:
        board(*arguments, output=output)
    assert not output.exists()
    assert hint in (refused.value.hint or "")
