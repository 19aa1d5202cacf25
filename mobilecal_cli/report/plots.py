"""The plots of the report, each an <svg> element."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.model import Extraction, FloatArray, Side, Solution, WheelGeometry, WheelTrack
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.figures import BLUE, FAINT, GREEN, INK, ORANGE, RED, figure, polygons, style, svg
from mobilecal_cli.report.numbers import nine_numbers, predicted_point_rms_m, station_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_LABELS = 40  # more labels than this are not readable
_MOST_OUTLINES = 150
_LABEL_CHARACTERS = 100  # that fit side by side under a wide plot
_TRAIL_POINTS = 400
_LEAST_SPAN_DEG = 20.0


def wheel_convergence(solution: Solution, extraction: Extraction) -> str:
    """Right wheel radius rR and wheel separation b over the iterations (paper's Fig. 5)."""
    rounds = np.arange(1, solution.linear.rounds + 1)
    numbers = _history(solution, extraction)
    with style():
        drawing, (radius, separation) = figure(7.2, 2.7, 1, 2)
        for axes, column, name in (
            (radius, 6, "right wheel radius [mm]"),
            (separation, 8, "wheel separation [mm]"),
        ):
            axes.plot(rounds, numbers[:, column], "o-", color=BLUE)
            axes.set_title(name)
            axes.margins(y=0.25)
            _round_axis(axes, solution)
        return svg(drawing, "wheels", "wheel radius and separation over the iterations")


def all_convergence(solution: Solution, extraction: Extraction) -> str:
    """Difference of each of the nine parameters from its final value, over the iterations."""
    numbers = _history(solution, extraction)
    apart = np.abs(numbers - numbers[-1])
    R = np.stack([parameters.T_h_c[:3, :3] for parameters in solution.linear.history])
    apart[:, :3] = np.abs(np.degrees([se3.log_so3(each @ R[-1].T) for each in R]))
    labels = ("x", "y", "z", "x", "y", "z", "right radius", "left radius", "separation")
    rounds = np.arange(1, len(numbers) + 1)
    with style():
        drawing, panels = figure(7.2, 2.7, 1, 3)
        colors = (BLUE, ORANGE, GREEN)
        for axes, first, name in zip(
            panels, (0, 3, 6), ("rotation [deg]", "translation [mm]", "wheels [mm]"), strict=True
        ):
            for k in range(3):
                distance = np.where(apart[:, first + k] > 1e-9, apart[:, first + k], np.nan)
                axes.plot(rounds, distance, "o-", color=colors[k], label=labels[first + k])
            if np.any(apart[:, first : first + 3] > 1e-9):
                axes.set_yscale("log")
                axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
                axes.minorticks_off()
            axes.set_title(name)
            axes.legend(loc="upper right")
            _round_axis(axes, solution)
        return svg(drawing, "nine", "difference of each parameter from its final value, over the iterations")


def refinement_convergence(solution: Solution) -> str:
    """Point error over the iterations of the refinement; "" without a refinement."""
    if solution.refinement is None:
        return ""
    error_mm = solution.refinement.point_rms_history_m * 1e3
    with style():
        drawing, (axes,) = figure(7.2, 2.2)
        axes.plot(np.arange(len(error_mm)), error_mm, "o-", color=BLUE, markersize=4)
        axes.set_title("point error [mm]")
        axes.set_xlabel("iteration of the refinement (0: linear solution)")
        axes.set_ylim(0, 1.15 * float(np.max(error_mm)) or 1.0)
        axes.locator_params(axis="x", integer=True)
        return svg(drawing, "refine", "point error over the iterations of the refinement")


def _history(solution: Solution, extraction: Extraction) -> FloatArray:
    return np.stack([nine_numbers(parameters, solution.cameras) for parameters in solution.linear.history])


def _round_axis(axes: Axes, solution: Solution) -> None:
    axes.set_xlabel("iteration")
    axes.locator_params(axis="x", integer=True)
    axes.axvline(solution.linear.rounds_to_tolerance, color=FAINT, linestyle="--", linewidth=1)


def seen_from_above(solution: Solution, extraction: Extraction, log: int) -> str:
    """Top view of one recording: path of the base, camera poses, and the board as measured from each station."""
    picked = [i for i, o in enumerate(extraction.observations) if o.log == log]
    seen = [extraction.observations[i] for i in picked]
    T_w_v, T_w_k = solution.residuals.T_w_v[picked], solution.residuals.T_w_k[picked]
    T_w_c = T_w_k @ se3.inverse(np.stack([o.T_c_k for o in seen]))
    board, square_m = extraction.board, float(np.median([o.square_m for o in seen]))
    ends_k = np.array([[-1, board.rows / 2, 0], [board.columns, board.rows / 2, 0]]) * square_m
    boards = se3.act(T_w_k, np.broadcast_to(ends_k, (len(seen), 2, 3)))
    times = np.array([o.time_ns for o in seen])
    path = trail(extraction.wheels[log], times, solution.parameters.wheels)
    with style():
        drawing, (axes,) = figure(7.2, 4.4, header_in=0.35)
        axes.plot(path[:, 0], path[:, 1], color=FAINT, linewidth=1.5, label="path of the base")
        nominal = extraction.rig.nominal.wheels
        if nominal is not None:
            before = trail(extraction.wheels[log], times, nominal)
            axes.plot(*before.T, color=RED, linewidth=1, linestyle=":", label="path with nominal wheels")
        size = 0.05 * float(max(np.ptp(np.concatenate([boards[..., :2].reshape(-1, 2), path]), axis=0)))
        for k, (a, b) in enumerate(boards[..., :2]):
            axes.plot(*np.stack([a, b]).T, color=GREEN, linewidth=1.5, alpha=0.6, label="_" if k else "board")
        arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004}
        x_axis = T_w_v[:, :2, 0] * size
        axes.quiver(*T_w_v[:, :2, 3].T, *x_axis.T, color=BLUE, label="base heading", **arrows)
        z_axis = T_w_c[:, :2, 2] / np.linalg.norm(T_w_c[:, :2, 2], axis=-1, keepdims=True) * size
        axes.quiver(*T_w_c[:, :2, 3].T, *z_axis.T, color=ORANGE, label="camera direction", **arrows)
        names = station_names(extraction)
        if len(picked) <= _MOST_LABELS:
            for i, at in zip(picked, T_w_v[:, :2, 3], strict=True):
                axes.annotate(names[i], at, (0, -11), textcoords="offset points", ha="center", fontsize=8)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x at the first station [m]")
        axes.set_ylabel("y [m]")
        drawing.legend(loc="upper left", ncols=5, fontsize=8)
        return svg(drawing, f"above{log}", "top view of the base path with cameras and board")


def trail(track: WheelTrack, times_ns: np.ndarray, wheels: WheelGeometry) -> FloatArray:
    """Path of the base by dead reckoning from the first to the last time, in the frame of the first: (n, 2), m."""
    start, end = max(times_ns[0], track.time_ns[0]), min(times_ns[-1], track.time_ns[-1])
    moments = np.unique(np.append(np.linspace(0, end - start, _TRAIL_POINTS).astype(np.int64) + start, end))
    if len(moments) < 2:
        return np.zeros((1, 2))
    legs = integrate(cut_at(track, moments), wheels)
    heading = np.cumsum(legs.psi_rad) - legs.psi_rad
    c, s = np.cos(heading), np.sin(heading)
    x, y = legs.t_m.T
    steps = np.stack([c * x - s * y, s * x + c * y], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def leg_residuals(solution: Solution, extraction: Extraction) -> str:
    """Point error and reprojection error of each leg."""
    residuals, names = solution.residuals, station_names(extraction)
    at = np.arange(len(residuals.legs))
    labels = [f"{names[i]}–{names[j]}" for i, j in residuals.legs]
    with style():
        drawing, (points, pixels) = figure(7.2, 4.4, 2, 1, sharex=True)
        points.bar(at, residuals.leg_point_rms_m * 1e3, color=BLUE)
        points.axhline(solution.point_rms_m * 1e3, color=INK, linewidth=1, label="all legs")
        points.axhline(
            predicted_point_rms_m(extraction, solution) * 1e3,
            color=ORANGE, linewidth=1.2, linestyle="--", label="expected from depth noise alone",
        )  # fmt: skip
        points.set_title("point error [mm]")
        points.legend(loc="upper right", ncols=2)
        points.margins(y=0.25)
        pixels.bar(at, residuals.leg_reprojection_px, color=BLUE)
        pixels.axhline(solution.reprojection_rms_px, color=INK, linewidth=1)
        pixels.set_title("reprojection error [px]")
        for axes in (points, pixels):
            axes.grid(visible=False, axis="x")
        _bar_labels(pixels, labels, "leg (from station–to station)")
        return svg(drawing, "legs", "point error and reprojection error of each leg")


def station_residuals(extraction: Extraction) -> str:
    """Residual of the flat board in the stereo pair, and the measured square size, at each station."""
    seen = extraction.observations
    at = np.arange(len(seen))
    square_mm = np.array([o.square_m for o in seen]) * 1e3
    with style():
        drawing, (stereo, square) = figure(7.2, 4.2, 2, 1, sharex=True)
        stereo.bar(at, [o.reprojection_px for o in seen], color=GREEN)
        stereo.set_title("stereo residual of the flat board [px]")
        square.plot(at, square_mm, "o", color=GREEN)
        if extraction.board.square_m is not None:
            stated_mm = extraction.board.square_m * 1e3
            square.axhline(stated_mm, color=INK, linewidth=1, label="stated")
            square.legend(loc="upper right")
        square.set_title("measured square size [mm]")
        square.margins(y=0.3)
        stereo.grid(visible=False, axis="x")
        _bar_labels(square, station_names(extraction), "station")
        return svg(drawing, "stations", "stereo residual and square size at each station")


def _bar_labels(axes: Axes, labels: list[str], name: str) -> None:
    longest = max(map(len, labels), default=0)
    every = max(1, -(-len(labels) * (longest + 2) // _LABEL_CHARACTERS))
    axes.set_xticks(np.arange(len(labels))[::every], labels[::every])
    axes.tick_params(axis="x", labelsize=8)
    axes.set_xlabel(name)


def head_angles(extraction: Extraction) -> str:
    """Pan and tilt angle at each station; "" if the chain names neither joint."""
    chain, seen = extraction.rig.chain, extraction.observations
    columns = [chain.joints.index(name) for name in (chain.pan, chain.tilt) if name in chain.joints]
    if not columns:
        return ""
    joints_deg = np.degrees(np.stack([o.joints for o in seen]))
    pan = joints_deg[:, columns[0]]
    other = joints_deg[:, columns[1]] if len(columns) == 2 else np.zeros(len(seen))
    with style():
        drawing, (axes,) = figure(3.5, 3.0)
        axes.plot(pan, other, "o", color=BLUE, alpha=0.8)
        if len(seen) <= _MOST_LABELS:
            for name, x, y in zip(station_names(extraction), pan, other, strict=True):
                axes.annotate(name, (x, y), (4, 4), textcoords="offset points", fontsize=8)
        labels = [_short(chain.joints[column]) + " [deg]" for column in columns]
        axes.set_xlabel(labels[0])
        axes.set_ylabel(labels[1] if len(columns) == 2 else "")
        axes.margins(0.15)
        axes.set_xlim(*_at_least(axes.get_xlim(), _LEAST_SPAN_DEG))
        axes.set_ylim(*_at_least(axes.get_ylim(), _LEAST_SPAN_DEG))
        return svg(drawing, "head", "head angles at each station")


def _at_least(limits: tuple[float, float], span: float) -> tuple[float, float]:
    """Limits at least a span apart, so that the noise of a fixed head does not look like motion."""
    low, high = limits
    more = max(0.0, span - (high - low)) / 2
    return low - more, high + more


def _short(name: str) -> str:
    shown = visible(name)
    return shown if len(shown) <= 30 else f"{shown[:29]}…"


def picture_coverage(extraction: Extraction, side: Side) -> str:
    """Outlines of the board in the images of one camera."""
    import cv2

    camera = extraction.rig.cameras.left if side == "left" else extraction.rig.cameras.right
    seen = extraction.observations
    chosen = np.unique(np.linspace(0, len(seen) - 1, min(len(seen), _MOST_OUTLINES)).astype(int))
    with style():
        drawing, (axes,) = figure(3.5, 3.0)
        outlines = []
        for i in chosen:
            corners = getattr(seen[i], side)
            measured = corners.pixels[corners.seen]
            hull = cv2.convexHull(measured.astype(np.float32), returnPoints=False)
            outlines.append(measured[hull.ravel()])
        polygons(axes, outlines, [(BLUE, 0.10)] * len(outlines))
        gap = np.full((1, 2), np.nan)  # one line with gaps between the outlines
        axes.plot(
            *np.concatenate([np.concatenate([o, o[:1], gap]) for o in outlines]).T,
            color=BLUE, linewidth=0.9, alpha=0.8,
        )  # fmt: skip
        frame = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * [camera.width, camera.height] - 0.5
        axes.plot(*frame.T, color=INK)
        axes.set_aspect("equal")
        axes.invert_yaxis()
        axes.set_title(f"{side} camera")
        axes.set_xlabel("u [px]")
        axes.set_ylabel("v [px]")
        axes.grid(visible=False)
        return svg(drawing, f"view-{side}", f"outlines of the board in the images of the {side} camera")
