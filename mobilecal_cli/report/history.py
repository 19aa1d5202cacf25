"""Plot of the nine parameters over several calibrations."""

from __future__ import annotations

from collections.abc import Sequence

from mobilecal_cli.comparison import History
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.parameters import PARAMETERS
from mobilecal_cli.report.svg import Axes, Canvas, Limits, standalone

_MOST_LABELS = 20
_WIDE, _HIGH = 300.0, 210.0


def history_plot(labels: Sequence[str], past: History) -> str:
    """An SVG file: change of each parameter since the first calibration, with bars of 2 sigma.

    Args:
        labels: labels of the calibrations, such as dates; the plot numbers them from 1.
        past: the parameters of all calibrations.
    """
    title = "change of each parameter since the first calibration, with bars of 2 sigma"
    shown = [f"{n}: {visible(label)}" for n, label in enumerate(labels[:_MOST_LABELS], 1)]
    if len(labels) > len(shown):
        shown.append(f"and {len(labels) - len(shown)} more")
    canvas = Canvas(3 * _WIDE, 3 * _HIGH + 10 + 16 * ((len(shown) + 2) // 3), title)
    for k, parameter in enumerate(PARAMETERS):
        unit, factor = parameter.shown_unit, parameter.factor
        change, std = past.change[:, k] * factor, past.std[:, k] * factor
        left, top = k % 3 * _WIDE, k // 3 * _HIGH
        y = Limits.of([0.0, *(change - 2 * std), *(change + 2 * std)], margin=0.1)
        box = (left, top, left + _WIDE, top + _HIGH)
        axes = Axes.of(canvas, Limits(0.5, len(labels) + 0.5), y, f"{parameter.name} [{unit}]", box)
        axes.grid(x=False)
        axes.level(0.0, "faint thin")
        for n, (value, s) in enumerate(zip(change.tolist(), std.tolist(), strict=True), 1):
            if s > 0:
                axes.line([(n, value - 2 * s), (n, value + 2 * s)], "blue")
            axes.dot(n, value, "blue" if s > 0 else "orange", tip=f"{n}: {value:+.3g} {unit}")
            canvas.text(axes.x(n), axes.y.start + 14, str(n), anchor="middle")
    for n, label in enumerate(shown):
        canvas.text(8 + n % 3 * _WIDE, 3 * _HIGH + 12 + 16 * (n // 3), label)
    return standalone(canvas.svg)
