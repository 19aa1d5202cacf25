"""Plots as SVG text: axes with linear or named scales, and marks that belong to stations.

Colors are classes, so that the page's style sheet decides on light and dark. A mark with stations has them in
`data-s`, by which the page's script links the plots.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TypeVar

import numpy as np

from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.text import visible

_Value = TypeVar("_Value", float, FloatArray)
WIDE, HALF = 640.0, 320.0  # widths of plots; two halves are side by side
NARROW = 400.0  # of a plot that is on its own, and as wide as a phone
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 10.0, 30.0, 40.0  # around the axes, for labels and title
_CHARACTER = 6.2  # width of a character of a small label
#: Style of a plot; the page's own variables are the colors.
STYLE = """
svg.plot text { fill: var(--ink); font: 12px system-ui, sans-serif; } svg.plot .small { font-size: 11px; }
svg.plot .title { font-weight: 600; } svg.plot .grid { stroke: var(--line); } svg.plot .axis { stroke: var(--faint); }
.blue { --c: var(--blue); } .orange { --c: var(--orange); } .green { --c: var(--green); } .red { --c: var(--red); }
.ink { --c: var(--ink); } .soft { --c: var(--soft); } .faint { --c: var(--faint); }
svg.plot .fill { fill: var(--c); } svg.plot .line { fill: none; stroke: var(--c); stroke-width: 1.7; }
svg.plot .thin { stroke-width: 1; } svg.plot .dash { stroke-dasharray: 5 4; } svg.plot .dots { stroke-dasharray: 1 4; }
svg.plot .dark { fill-opacity: .75; } svg.plot .half { fill-opacity: .55; } svg.plot .light { fill-opacity: .35; }
svg.plot .line.on { stroke-width: 3; } svg.plot .fill.on { stroke: var(--ink); stroke-width: 2; }
"""


def number(value: float) -> str:
    """A coordinate to 0.01, finer than any screen."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


@dataclass(frozen=True, slots=True)
class Scale:
    """Values from `low` to `high`, shown from coordinate `start` to `end`."""

    low: float
    high: float
    start: float = 0.0
    end: float = 1.0

    @classmethod
    def of(
        cls, values: Iterable[float], zero: bool = False, margin: float = 0.06, least: float = 0.0
    ) -> Scale:
        """Limits around finite values, from zero on request, and at least a span apart."""
        finite = [float(v) for v in values if math.isfinite(v)] or [0.0, 1.0]
        low, high = min(finite), max(finite)
        if zero:
            return cls(0.0, (high or 1.0) * (1 + margin))
        room = margin * (high - low) or max(abs(high), 1.0) * 0.1
        room += max(0.0, least - (high - low + 2 * room)) / 2
        return cls(low - room, high + room)

    def __call__(self, value: _Value) -> _Value:
        """Coordinate of a value, or of each of an array."""
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    @property
    def ticks(self) -> list[float]:
        """Round values to label, in steps of 1, 2, 2.5 or 5 times a power of ten."""
        span, most = self.high - self.low, max(4, min(7, int(abs(self.end - self.start) / 55)))
        power = 10.0 ** math.floor(math.log10(span / most))
        step = next(power * k for k in (1, 2, 2.5, 5, 10, 20) if span / (power * k) <= most)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


@dataclass(slots=True)
class Canvas:
    """An <svg> element under construction, with a title for screen readers."""

    width: float
    height: float
    title: str
    parts: list[str] = field(default_factory=list)

    def text(self, x: float, y: float, text: str, kind: str = "small", anchor: str = "start") -> None:
        """One line of text; anchor "start", "middle" or "end"."""
        self.parts.append(
            f'<text x="{number(x)}" y="{number(y)}" class="{kind}" text-anchor="{anchor}">'
            f"{escape(visible(text))}</text>"
        )

    def shape(
        self, tag: str, kind: str, stations: Sequence[int] = (), tip: str = "", **attributes: float | str
    ) -> None:
        """An element with a class, the stations it belongs to, a tooltip, and attributes ("_" for "-")."""
        shown = " ".join(
            f'{name.replace("_", "-")}="{value if isinstance(value, str) else number(value)}"'
            for name, value in attributes.items()
        )
        linked = f' data-s="{" ".join(map(str, stations))}"' if len(stations) else ""
        inside = f"<title>{escape(visible(tip))}</title>" if tip else ""
        self.parts.append(f'<{tag} class="{kind}" {shown}{linked}>{inside}</{tag}>')

    def path(
        self, points: FloatArray, kind: str, closed: bool = False, stations: Sequence[int] = (), tip: str = ""
    ) -> None:
        """A line through points, (n, 2); gaps where they are not finite."""
        steps, up = [], True
        for x, y in points.tolist():
            if not (math.isfinite(x) and math.isfinite(y)):
                up = True
                continue
            steps.append(f"{'M' if up else 'L'}{number(x)} {number(y)}")
            up = False
        self.shape("path", kind, stations, tip, d=f"{''.join(steps)}{'Z' if closed else ''}")

    def legend(self, entries: Sequence[tuple[str, str]], x: float, y: float) -> float:
        """Samples with labels in a row that wraps at the right edge: (class of the sample, label); the last row's y."""
        at = x
        for kind, label in entries:
            wide = 22 + _CHARACTER * len(label)
            if at + wide > self.width and at > x:
                at, y = x, y + 16
            if "fill" in kind:
                self.shape("rect", kind, x=at, y=y - 9, width=11, height=11)
            else:
                self.path(np.array([[at, y - 4], [at + 13, y - 4]]), kind)
            self.text(at + 17, y, label)
            at += wide + 8
        return y

    @property
    def svg(self) -> str:
        """The element."""
        return (
            f'<svg class="plot" role="img" aria-label="{escape(self.title)}" '
            f'viewBox="0 0 {number(self.width)} {number(self.height)}">{"".join(self.parts)}</svg>'
        )


@dataclass(slots=True)
class Axes:
    """A pair of axes on a canvas."""

    canvas: Canvas
    x: Scale
    y: Scale

    @classmethod
    def of(
        cls,
        canvas: Canvas,
        x: Scale,
        y: Scale,
        title: str = "",
        box: tuple[float, float, float, float] | None = None,
    ) -> Axes:
        """Axes in a box (left, top, right, bottom) of the canvas, by default all of it; labels are inside."""
        left, top, right, bottom = box or (0.0, 0.0, canvas.width, canvas.height)
        if title:
            canvas.text(left + 8, top + _TOP - 14, title, "title")
        return cls(
            canvas,
            replace(x, start=left + _LEFT, end=right - _RIGHT),
            replace(y, start=bottom - _BOTTOM, end=top + _TOP),
        )

    def with_equal_units(self) -> Axes:
        """Axes with one unit on both, the data in the middle."""
        unit = min(abs(s.end - s.start) / (s.high - s.low) for s in (self.x, self.y))
        scales = []
        for s in (self.x, self.y):
            half, middle = abs(s.end - s.start) / unit / 2, (s.low + s.high) / 2
            scales.append(replace(s, low=middle - half, high=middle + half))
        return Axes(self.canvas, *scales)

    def grid(self, x_label: str = "", x: bool = True) -> None:
        """Grid lines, tick labels, on the x axis if `x`, and the x axis's label."""
        for value in self.y.ticks:
            at = self.y(value)
            self._line(self.x.start, at, self.x.end, at, "grid")
            self.canvas.text(self.x.start - 5, at + 4, f"{round(value, 12) + 0.0:.7g}", anchor="end")
        for value in self.x.ticks if x else ():
            at = self.x(value)
            self._line(at, self.y.start, at, self.y.end, "grid")
            label = f"{round(value, 12) + 0.0:.7g}"  # without the rounding errors of the step
            self.canvas.text(at, self.y.start + 14, label, anchor="middle")
        self._line(self.x.start, self.y.start, self.x.end, self.y.start, "axis")
        if x_label:
            self.canvas.text((self.x.start + self.x.end) / 2, self.y.start + 31, x_label, anchor="middle")

    def names(self, labels: Sequence[str], x_label: str) -> None:
        """Names under whole numbers 0, 1, ...; only every second, third, ... where they would touch."""
        wide = _CHARACTER * (max(map(len, labels), default=0) + 2)
        every = max(1, math.ceil(len(labels) * wide / max(self.x.end - self.x.start, 1.0)))
        for k in range(0, len(labels), every):
            self.canvas.text(self.x(k), self.y.start + 14, labels[k], anchor="middle")
        self.canvas.text((self.x.start + self.x.end) / 2, self.y.start + 31, x_label, anchor="middle")

    def _line(self, x1: float, y1: float, x2: float, y2: float, kind: str) -> None:
        self.canvas.shape("line", kind, x1=x1, y1=y1, x2=x2, y2=y2)

    def at(self, points: FloatArray) -> FloatArray:
        """Coordinates of points, (n, 2), on the canvas."""
        return np.column_stack([self.x(points[:, 0]), self.y(points[:, 1])])

    def line(
        self,
        points: Sequence[Sequence[float]] | FloatArray,
        kind: str,
        stations: Sequence[int] = (),
        tip: str = "",
        closed: bool = False,
    ) -> None:
        """A line through points, (n, 2), in the units of the axes."""
        self.canvas.path(self.at(np.asarray(points)), f"line {kind}", closed, stations, tip)

    def clipped_line(self, points: FloatArray, kind: str) -> None:
        """A line through points, (n, 2), without those outside the axes."""
        x, y = np.asarray(points).T
        inside = (x >= self.x.low) & (x <= self.x.high) & (y >= self.y.low) & (y <= self.y.high)
        self.line(np.where(inside[:, None], points, np.nan), kind)

    def level(self, value: float, kind: str) -> None:
        """A horizontal line."""
        self._line(self.x.start, self.y(value), self.x.end, self.y(value), f"line {kind}")

    def dot(
        self, x: float, y: float, kind: str, stations: Sequence[int] = (), tip: str = "", r: float = 3.5
    ) -> None:
        """A dot."""
        self.canvas.shape("circle", f"fill {kind}", stations, tip, cx=self.x(x), cy=self.y(y), r=r)

    def bar(self, x: float, value: float, kind: str, stations: Sequence[int], tip: str) -> None:
        """A bar from the axis to a value."""
        wide, top = 0.76 * abs(self.x(1) - self.x(0)), self.y(value)
        left, high = self.x(x) - wide / 2, max(self.y.start - top, 0.0)
        self.canvas.shape("rect", f"fill {kind}", stations, tip, x=left, y=top, width=wide, height=high)

    def arrow(
        self, start: FloatArray, end: FloatArray, kind: str, stations: Sequence[int] = (), tip: str = ""
    ) -> None:
        """An arrow between two points, (2,) each, in the units of the axes."""
        a, b = self.at(np.array([start, end]))
        along = b - a
        length = float(np.hypot(*along))
        if length < 0.5:
            return
        u = along / length * min(6.0, 0.5 * length)
        side = np.array([-u[1], u[0]]) * 0.5
        points = np.array([a, b, [math.nan] * 2, b - u + side, b, b - u - side])
        self.canvas.path(points, f"line {kind}", stations=stations, tip=tip)


def standalone(element: str) -> str:
    """An element as a separate file that follows the viewer's light or dark mode."""
    colors = (
        "svg{background:#fff;--ink:#1c2430;--line:#e1e5ea;--faint:#8a95a3;--blue:#1f6fd1;--orange:#d9730d;"
        "--green:#14875a;--red:#c4312b}@media(prefers-color-scheme:dark){svg{background:#1b2129;--ink:#e6eaf0;"
        "--line:#2c343f;--faint:#5b6675;--blue:#62a8f5;--orange:#f0a04b;--green:#43c98d;--red:#f0746c}}"
    )
    head = element.index(">") + 1
    opening = element[: head - 1].replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return f"{opening}><style>{colors}{STYLE}</style>{element[head:]}\n"
