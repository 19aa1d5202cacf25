"""Plot of the nine parameters over several calibrations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mobilecal_cli.comparison import History
from mobilecal_cli.model import NINE
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.figures import BLUE, FAINT, INK, ORANGE, figure, standalone, style, svg
from mobilecal_cli.report.units import SHOWN

_MOST_LABELS = 20


def history_plot(labels: Sequence[str], past: History) -> str:
    """An SVG file: change of each parameter since the first calibration, with bars of 2 sigma.

    Args:
        labels: labels of the calibrations, such as dates; the plot numbers them from 1.
        past: the parameters of all calibrations.
    """
    at = np.arange(1, len(labels) + 1)
    with style():
        drawing, panels = figure(9.0, 6.4, 3, 3, header_in=0.4, sharex=True)
        for k, (axes, name) in enumerate(zip(panels, NINE, strict=True)):
            unit, factor = SHOWN[name]
            change, std = past.change[:, k] * factor, past.std[:, k] * factor
            known = std > 0
            axes.axhline(0, color=FAINT, linewidth=1)
            axes.errorbar(at[known], change[known], 2 * std[known], fmt="o", color=BLUE, capsize=3)
            axes.plot(at[~known], change[~known], "x", color=ORANGE)
            axes.set_title(f"{name} [{unit}]")
            axes.margins(x=0.1, y=0.2)
            axes.locator_params(axis="x", integer=True)
        shown = [f"{n}: {visible(label)}" for n, label in enumerate(labels[:_MOST_LABELS], 1)]
        more = f" and {len(labels) - len(shown)} more" if len(labels) > len(shown) else ""
        drawing.text(0.01, 0.005, ",  ".join(shown) + more, fontsize=7, color=INK, va="bottom")
        title = "change of each parameter since the first calibration, with bars of 2 sigma"
        return standalone(svg(drawing, "history", title))
