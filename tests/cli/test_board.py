"""`mobilecal board` on the command line."""

from __future__ import annotations

from typer.testing import CliRunner

from mobilecal_cli.cli import app


def run(*arguments):
    return CliRunner().invoke(app, ["board", *arguments])


def test_a_board_and_its_line_for_rig_yaml(tmp_path):
    out = tmp_path / "board.pdf"
    done = run("--corners", "8x5", "--square", "0.08", "--output", str(out))
    assert done.exit_code == 0
    lines = done.output.splitlines()
    assert lines[0] == "board: {columns: 8, rows: 5, square_m: 0.08}"
    assert "Print at actual size on A1 (841 x 594 mm), and measure the scale bar." in lines
    assert out.read_bytes().startswith(b"%PDF-1.6")


def test_warnings(tmp_path):
    done = run("--corners", "8x6", "--square", "0.08", "--output", str(tmp_path / "board.pdf"))
    assert (
        "A board of 8x6 corners looks the same upside down. Prefer counts of different parity" in done.output
    )
    assert "White border: 8 mm. Mount the board on a light backing" in done.output
    again = run("--corners", "8x6", "--square", "0.08", "--output", str(tmp_path / "board.pdf"))
    assert again.exception.exit_code == 7
    marked = run("--corners", "8x6", "--square", "0.02", "--charuco", "--output", str(tmp_path / "other.pdf"))
    assert "upside down" not in marked.output


def test_a_size_that_is_no_size(tmp_path):
    done = run("--corners", "8-6", "--square", "0.08", "--output", str(tmp_path / "board.pdf"))
    assert "--corners 8-6: not of the form COLUMNSxROWS" in done.exception.message
