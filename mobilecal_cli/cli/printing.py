"""The command that makes a board to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import Force, counts_of
from mobilecal_cli.cli.verdict import written_line
from mobilecal_cli.targets import Paper

#: White around the board in squares, below which some detectors miss it in front of a dark wall.
LEAST_BORDER = 0.3


@app.command()
def board(
    corners: Annotated[str, typer.Option(metavar="COLUMNSxROWS", help="Inner corners, for example 8x5.")],
    square: Annotated[float, typer.Option(metavar="METERS", help="Side of a square, m.")],
    charuco: Annotated[
        bool, typer.Option("--charuco", help="With markers: the board may be partly visible.")
    ] = False,
    dictionary: Annotated[
        str | None,
        typer.Option(help="ChArUco: markers, by OpenCV name. [default: the smallest DICT_5X5 that suffices]"),
    ] = None,
    marker_share: Annotated[
        float | None, typer.Option(help="ChArUco: marker side / square side. [default: 0.75]")
    ] = None,
    paper: Annotated[
        Paper,
        typer.Option(help="Page; auto: the smallest of A4 to A0; exact: as large as the board needs."),
    ] = Paper.auto,
    output: Annotated[Path, typer.Option("--output", "-o", readable=False, help="PDF to write.")] = Path(
        "board.pdf"
    ),
    force: Force = False,
) -> None:
    """Make a board to print at true scale, as PDF.

    Prints the line for rig.yaml. The page also has a scale bar to measure after printing.

    Example: mobilecal board --corners 8x5 --square 0.08 --output board.pdf

    With markers: mobilecal board --corners 8x5 --square 0.08 --charuco
    """
    from mobilecal_cli.export import check_file, write_file
    from mobilecal_cli.pipeline import printing

    check_file(output, force)
    columns, rows = counts_of("--corners", corners)
    made = printing.print_board(columns, rows, square, charuco, dictionary, marker_share, paper)
    write_file(output, made.content, force)
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
