"""`mobilecal board`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import counts_of, written_line
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.targets import Paper

#: Markers in the dictionaries of 5 x 5 cells; small ones have fewer false detections.
_FAMILIES = (50, 100, 250, 1000)
#: White around the board in squares, below which some detectors miss it in front of a dark wall.
LEAST_BORDER = 0.3


def board(
    corners: Annotated[str, Option(metavar="COLUMNSxROWS")],
    square: Annotated[float, Option(metavar="METERS")],
    charuco: bool = False,
    dictionary: str | None = None,
    marker_share: float | None = None,
    paper: Paper = "auto",
    output: Path = Path("board.pdf"),
    force: bool = False,
) -> None:
    """Make a board to print at true scale, as PDF.

    Prints the line for rig.yaml. The page also has a scale bar to measure after printing.

    Example: mobilecal board --corners 8x5 --square 0.08 --output board.pdf

    With markers: mobilecal board --corners 8x5 --square 0.08 --charuco

    Args:
        corners: Inner corners, for example 8x5.
        square: Side of a square, m.
        charuco: With markers: the board may be partly visible.
        dictionary: ChArUco: markers, by OpenCV name. [default: the smallest DICT_5X5 that suffices]
        marker_share: ChArUco: marker side / square side. [default: 0.75]
        paper: Page; auto: the smallest of A4 to A0; exact: as large as the board needs.
        output: PDF to write.
    """
    from mobilecal_cli.export.board_print import board_pdf
    from mobilecal_cli.export.outputs import check_output, write_outputs
    from mobilecal_cli.rig.config import load_rig

    if output.suffix.lower() not in ("", ".pdf"):
        raise ConfigError(f"--output {output}: a board is written as PDF", "use a name that ends with .pdf")
    columns, rows = counts_of("--corners", corners)
    flags: dict[str, object] = {
        "board.kind": "charuco" if charuco else "checkerboard",
        "board.columns": columns,
        "board.rows": rows,
        "board.square_m": square,
    }
    if charuco:
        markers = (columns + 1) * (rows + 1) // 2
        enough = next((size for size in _FAMILIES if size >= markers), _FAMILIES[-1])
        flags["board.dictionary"] = dictionary or f"DICT_5X5_{enough}"
        flags["board.marker_share"] = 0.75 if marker_share is None else marker_share
    elif dictionary is not None or marker_share is not None:
        raise ConfigError("--dictionary and --marker-share apply only to ChArUco boards", "add --charuco")
    stated = load_rig(None, flags).board.stated
    assert stated is not None
    check_output(output, force)
    made = board_pdf(stated, paper)
    write_outputs({output: made.content}, force)
    typer.echo(made.config)
    if not charuco and (columns - rows) % 2 == 0:
        typer.echo(
            f"A board of {corners} corners looks the same upside down. Prefer counts of different parity, such as 8x5.",
            err=True,
        )
    if made.border_mm < LEAST_BORDER * square * 1e3:
        typer.echo(
            f"White border: {made.border_mm:.0f} mm. Mount the board on a light backing, or use a larger page.",
            err=True,
        )
    typer.echo(f"Print at actual size on {made.page}, and measure the scale bar.")
    typer.echo(written_line(output))
