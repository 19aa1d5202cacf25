"""Figures as inline SVG: no network, no dates, colors for light and dark mode.

Figures are drawn in placeholder colors, which are then replaced by the page's CSS variables.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from mobilecal_cli.model import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, BLUE, ORANGE, GREEN, RED = "#010101", "#020202", "#030303", "#040404", "#050505", "#060606"
_VARIABLES = {INK: "ink", FAINT: "faint", BLUE: "blue", ORANGE: "orange", GREEN: "green", RED: "red"}
_SETTINGS: dict[str, Any] = {
    "svg.fonttype": "none",  # text stays text: small, searchable, in the page's font
    "svg.hashsalt": "mobilecal",
    "text.parse_math": False,  # a joint name can contain a dollar sign
    "font.family": "sans-serif",
    "font.size": 10.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.facecolor": "none",
    "axes.titlecolor": INK,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # fixed: automatic placement computes all tick labels twice
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "figure.facecolor": "none",
    "grid.color": FAINT,
    "grid.alpha": 0.5,
    "grid.linewidth": 0.6,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.8,
    "lines.markersize": 5.0,
}


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib's defaults with the settings of this module, independent of the user's matplotlibrc."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)  # type: ignore[arg-type]  # its keys are Literals
        yield


def figure(
    width_in: float,
    height_in: float,
    rows: int = 1,
    columns: int = 1,
    *,
    header_in: float = 0.32,
    sharex: bool = False,
) -> tuple[Figure, Sequence[Axes]]:
    """A figure and its axes in reading order. Call it inside `style`.

    The margins are fixed, in inches, for tick and axis labels of usual length: Matplotlib's layout engines draw
    everything twice to find them, which doubles the time.
    """
    from matplotlib.figure import Figure as NewFigure

    new = NewFigure(figsize=(width_in, height_in))
    margins = {
        "left": 0.75 / width_in,
        "right": 1 - 0.12 / width_in,
        "top": 1 - header_in / height_in,
        "bottom": 0.56 / height_in,
    }
    inner_in = (width_in - 0.87) / columns
    spaces = {"wspace": 0.55 / (inner_in - 0.55), "hspace": 0.32}
    grid = new.subplots(rows, columns, squeeze=False, gridspec_kw=margins | spaces, sharex=sharex)
    return new, list(grid.ravel())


def polygons(axes: Axes, corners: Sequence[FloatArray], colors: Sequence[tuple[str, float]]) -> None:
    """Fill polygons, (n, 2) corners each, with one color and opacity per polygon, as a single artist."""
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(corners), facecolors=list(colors), linewidths=0))


def svg(drawing: Figure, name: str, title: str) -> str:
    """The figure as an <svg> element that scales with the page.

    Args:
        drawing: a figure made inside `style`.
        name: prefix that makes the ids unique among the figures of a page.
        title: description for screen readers, plain ASCII.
    """
    stream = io.StringIO()
    drawing.savefig(
        stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
    )
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    text = text.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)
    for color, variable in _VARIABLES.items():
        text = text.replace(color, f"var(--{variable})")
    # Round coordinates in the tags, not numbers in the texts: 0.01 pt is finer than any screen.
    return re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\d\.\d{2})\d+", r"\1", tag.group()), text)


def standalone(element: str) -> str:
    """An element of `svg` as a separate file that follows the viewer's light or dark mode."""
    colors = (
        "svg{background:#fff;--ink:#1c2430;--faint:#b4bdc8;--blue:#1f6fd1;--orange:#d9730d;--green:#14875a;--red:#c4312b}"
        "@media(prefers-color-scheme:dark){svg{background:#1b2129;--ink:#e6eaf0;--faint:#5b6675;--blue:#62a8f5;"
        "--orange:#f0a04b;--green:#43c98d;--red:#f0746c}}"
    )
    head = element.index(">") + 1
    return f"{element[:head]}<style>{colors}</style>{element[head:]}\n"
