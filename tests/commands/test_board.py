"""`mobilecal board` on the command line."""

import pytest

from tests.command import run, succeeded


def test_a_board_and_its_line_for_rig_yaml(tmp_path):
    out = tmp_path / "board.pdf"
    done = succeeded("board", "--corners", "8x5", "--square", "0.08", "--output", out)
    lines = done.out.splitlines()
    assert lines[0] == "board: {columns: 8, rows: 5, square_m: 0.08}"
    assert "Print at actual size on A1 (841 x 594 mm), and measure the scale bar." in lines
    assert out.read_bytes().startswith(b"%PDF-1.6")


@pytest.mark.parametrize("name", ["board.svg", "board.png"])
def test_another_format_is_refused(tmp_path, name):
    done = run("board", "--corners", "8x5", "--square", "0.08", "--output", name, cwd=tmp_path)
    assert (done.code, done.left) == (2, [])
    assert "a board is written as PDF" in done.err


def test_warnings(tmp_path):
    done = run("board", "--corners", "8x6", "--square", "0.08", "--output", tmp_path / "board.pdf")
    assert "A board of 8x6 corners looks the same upside down. Prefer counts of different parity" in done.err
    assert "White border: 8 mm. Mount the board on a light backing" in done.err
    again = run("board", "--corners", "8x6", "--square", "0.08", "--output", tmp_path / "board.pdf")
    assert again.code == 7
    marked = run(
        "board", "--corners", "8x6", "--square", "0.02", "--charuco", "--output", tmp_path / "other.pdf"
    )
    assert "upside down" not in marked.err


@pytest.mark.parametrize("corners", ["9" * 5000 + "x6", "²x6", "٩x6", "9x", "x", "9x6x5", "8-6"])
def test_a_size_that_no_integer_can_have(tmp_path, corners):
    """int() raised ValueError for digits that it does not know, and for more than 4300 of them."""
    for command in (("board", "--square", "0.08", "--corners"), ("calibrate", "log.mcap", "--board")):
        done = run(*command, corners, cwd=tmp_path)
        assert (done.code, done.left) == (2, [])
        assert "not of the form COLUMNSxROWS" in done.err
        assert len(done.err) < 200
