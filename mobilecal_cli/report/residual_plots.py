"""Plots of residuals, correlations and the error budget. Each is an <svg> element."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.model import NINE, Extraction, FloatArray, IntArray, Side, Solution
from mobilecal_cli.report.at_work import FIGURES
from mobilecal_cli.report.budget import families
from mobilecal_cli.report.figures import BLUE, FAINT, GREEN, INK, ORANGE, RED, figure, polygons, style, svg

if TYPE_CHECKING:
    from matplotlib.patches import Patch

_CELLS = (12, 9)
_LEAST_IN_CELL = 3  # cells with fewer corners show no mean
# Error budget: dark shades for measurements, light ones for what the robot description states.
_FAMILY_COLORS = {
    "corners": (BLUE, 0.75),
    "joint readings": (ORANGE, 0.75),
    "floor": (GREEN, 0.75),
    "wheels": (RED, 0.75),
    "encoder steps": (INK, 0.55),
    "time stamps": (INK, 0.3),
    "camera_info": (BLUE, 0.35),
    "head geometry": (ORANGE, 0.35),
    "board": (GREEN, 0.35),
    "nominal values": (RED, 0.3),
    "other": (FAINT, 0.6),
}
_BUDGET_LABELS = {
    "camera_m": "camera position",
    "camera_rad": "camera rotation",
    "along_m_per_m": "distance per meter",
    "heading_rad_per_m": "heading per meter",
    "heading_rad_per_turn": "heading per turn",
}
_LEAST_SHARE, _LABELED_SHARE = 0.005, 0.08
_KINDS = {
    "corners": "corners",
    "station": "station",
    "slip": "leg (slip)",
    "joint": "joint reading",
}


def picture_residuals(extraction: Extraction, side: Side) -> str:
    """Residuals of the corners from the fitted flat board across the image: a heat map with mean arrows.

    The board's pose at each station comes from the stereo pair, so the robot's motion has no influence.
    """
    camera = extraction.rig.cameras.left if side == "left" else extraction.rig.cameras.right
    pixels, residual = _board_residuals(extraction, side)
    size = np.array([camera.width, camera.height])
    cell, mean, spread = _cells(pixels, residual, size)
    with style():
        drawing, (axes,) = figure(3.5, 3.2)
        axes.set_title(f"{side} camera")
        if len(cell):
            edge = size / _CELLS
            middle = (cell + 0.5) * edge
            most = float(spread.max())
            square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
            levels = spread / most if most else spread
            polygons(
                axes, [(c + square) * edge for c in cell], [(ORANGE, 0.6 * float(level)) for level in levels]
            )
            longest = float(np.linalg.norm(mean, axis=1).max())
            scale = 0.9 * edge.min() / longest if longest else 1.0
            arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.006}
            axes.quiver(*middle.T, *(mean * scale).T, color=BLUE, **arrows)
            axes.set_xlabel(f"darkest: {most:.2g} px rms; longest arrow: {longest:.2g} px", fontsize=8)
        axes.set_xlim(-0.5, size[0] - 0.5)
        axes.set_ylim(size[1] - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.grid(visible=False)
        return svg(drawing, f"residual-{side}", f"corner residuals across the image of the {side} camera")


def _board_residuals(extraction: Extraction, side: Side) -> tuple[FloatArray, FloatArray]:
    """Detected corners of all stations, (n, 2), and their residuals from the fitted board, (n, 2), px."""
    cameras, seen = extraction.rig.cameras, extraction.observations
    camera, T_camera_c = (
        (cameras.left, np.eye(4)) if side == "left" else (cameras.right, se3.inverse(cameras.T_c_r))
    )
    pixels, residual = [], []
    for o in seen:
        corners = o.left if side == "left" else o.right
        points = se3.act(T_camera_c @ o.T_c_k, extraction.board.grid() * o.square_m)
        pixels.append(corners.pixels[corners.seen])
        residual.append((corners.pixels - project(camera, points))[corners.seen])
    return np.concatenate(pixels), np.concatenate(residual)


def _cells(
    pixels: FloatArray, residual: FloatArray, size: IntArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Cells with enough corners, (k, 2), with their mean residual, (k, 2), and root mean square, (k,), px."""
    at = np.floor((pixels + 0.5) / size * _CELLS).astype(np.int64).clip(0, np.array(_CELLS) - 1)
    cells, number, count = np.unique(at, axis=0, return_inverse=True, return_counts=True)
    number = number.ravel()
    mean = np.stack([np.bincount(number, residual[:, k], len(cells)) / count for k in (0, 1)], axis=1)
    spread = np.sqrt(np.bincount(number, np.sum(residual**2, axis=1), len(cells)) / count)
    enough = count >= _LEAST_IN_CELL
    return cells[enough], mean[enough], spread[enough]


def correlation_matrix(solution: Solution) -> str:
    """Correlation matrix of the nine parameters; "" without a covariance."""
    found = solution.uncertainty
    if found is None:
        return ""
    std = np.sqrt(np.diag(found.reference_covariance))
    std = np.where(std > 0, std, np.nan)
    correlation = found.reference_covariance / np.outer(std, std)
    with style():
        drawing, (axes,) = figure(5.2, 4.4, header_in=0.1)
        square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
        known = [
            ((i, j), float(value)) for (i, j), value in np.ndenumerate(correlation) if np.isfinite(value)
        ]
        polygons(
            axes,
            [np.add(square, (j, i)) for (i, j), _ in known],
            [(BLUE if value > 0 else ORANGE, 0.75 * min(1.0, abs(value))) for _, value in known],
        )
        for (i, j), value in known:
            axes.text(j, i, f"{value:+.2f}" if i != j else "1", ha="center", va="center", fontsize=7)
        axes.set_xticks(range(len(NINE)), NINE, fontsize=7, rotation=35, ha="right")
        axes.set_yticks(range(len(NINE)), NINE, fontsize=7)
        axes.set_xlim(-0.5, len(NINE) - 0.5)
        axes.set_ylim(len(NINE) - 0.5, -0.5)
        axes.grid(visible=False)
        return svg(drawing, "correlation", "correlation matrix of the nine parameters")


def error_budget(solution: Solution) -> str:
    """What each variance consists of, one bar per parameter and expected error; "" without a budget."""
    found = solution.uncertainty
    if found is None:
        return ""
    names, shares = families(solution)
    at_work = [figure for figure in FIGURES if figure.limit is not None]
    fields = [*NINE, *found.budget.at_work]
    columns = [*range(len(NINE)), *(fields.index(figure.field) for figure in at_work)]
    labels = [*NINE, *(_BUDGET_LABELS[figure.field] for figure in at_work)]
    shares = shares[:, columns]
    used = [k for k in range(len(names)) if shares[k].max() > _LEAST_SHARE]
    left = np.zeros(len(columns))
    square = np.array([(0, -0.36), (1, -0.36), (1, 0.36), (0, 0.36)])
    with style():
        drawing, (axes,) = figure(7.2, 4.6, header_in=0.75)
        axes.set_position((0.18, 0.12, 0.76, 0.72))  # space for the labels
        for k in used:
            boxes = [
                square * (w, 1) + (x, -y)
                for y, (x, w) in enumerate(zip(left, shares[k], strict=True))
                if w > 0
            ]
            polygons(axes, boxes, [_FAMILY_COLORS[names[k]]] * len(boxes))
            for y, (x, w) in enumerate(zip(left, shares[k], strict=True)):
                if w > _LABELED_SHARE:
                    axes.text(x + w / 2, -y, f"{100 * w:.0f} %", ha="center", va="center", fontsize=7)
            left = left + shares[k]
        axes.set_yticks([-y for y in range(len(labels))], labels, fontsize=8)
        axes.set_xlim(0, 1)
        axes.set_ylim(-len(labels) + 0.4, 0.6)
        axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        axes.set_xlabel("share of the variance")
        axes.grid(visible=False)
        patches = [_patch(*_FAMILY_COLORS[names[k]]) for k in used]
        drawing.legend(patches, [names[k] for k in used], loc="upper right", ncols=5, fontsize=8)
        return svg(drawing, "budget", "error budget: what each variance consists of")


def _patch(color: str, opacity: float) -> Patch:
    from matplotlib.patches import Patch as NewPatch

    return NewPatch(facecolor=color, alpha=opacity)


def over_time(solution: Solution, extraction: Extraction, log: int) -> str:
    """Leg and stereo residuals of one recording over time, with outliers and rejected stations."""
    seen, residuals = extraction.observations, solution.residuals
    mine = [leg for leg, (i, _) in enumerate(residuals.legs) if seen[i].log == log]
    stations = [o for o in seen if o.log == log]
    rejected = [r for r in extraction.rejections if r.log == log and r.time_ns]
    outliers = [o for o in solution.outliers if o.log == log]
    start = min([o.time_ns for o in stations] + [r.time_ns for r in rejected])

    def since(time_ns: int) -> float:
        return (time_ns - start) * 1e-9

    with style():
        drawing, (axes,) = figure(7.2, 2.9, header_in=0.5)
        middle = [(since(seen[i].time_ns) + since(seen[j].time_ns)) / 2 for i, j in residuals.legs[mine]]
        axes.plot(middle, residuals.leg_reprojection_px[mine], "o", color=BLUE, label="legs")
        own = [(since(o.time_ns), o.reprojection_px) for o in stations]
        axes.plot(*np.array(own).reshape(-1, 2).T, ".", color=FAINT, label="stereo pair alone")
        axes.set_yscale("symlog", linthresh=1.0)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_ylim(bottom=0)
        low = axes.get_ylim()[0]
        for kind, mark in (("station", "x"), ("slip", "v"), ("joint", "+"), ("corners", "1")):
            times = [since(o.time_ns) for o in outliers if o.kind == kind]
            if times:
                axes.plot(times, np.full(len(times), low), mark, color=RED, clip_on=False, markersize=8,
                          label=f"outlier: {_KINDS[kind]}")  # fmt: skip
        if rejected:
            axes.plot([since(r.time_ns) for r in rejected], np.full(len(rejected), low), "|", color=INK,
                      clip_on=False, markersize=10, label="rejected image or station")  # fmt: skip
        axes.set_xlabel("time since the first station [s]")
        drawing.text(0.01, 0.99, "residual [px]", va="top", fontweight="bold")
        drawing.legend(loc="upper right", ncols=3, fontsize=8)
        return svg(drawing, f"time{log}", "residuals over time, with outliers and rejected stations")
