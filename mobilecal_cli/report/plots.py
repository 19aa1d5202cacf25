"""The plots of the recording and of the motion, each an <svg> element, "" where there is nothing to show."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.model import Extraction, FloatArray, Side, Solution, WheelGeometry, WheelTrack
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.drawn import plot
from mobilecal_cli.report.numbers import PARAMETERS, lengths_mm, reference_pose, station_names
from mobilecal_cli.report.svg import HALF, WIDE, Axes, Canvas, Limits, Scale

_MOST_LABELS = 40  # more labels than this are not readable
_MOST_OUTLINES = 150
_TRAIL_POINTS = 400
_LEAST_SPAN_DEG = 20.0  # so that the noise of a fixed head does not look like motion


@plot(
    "convergence",
    "Iterations of the linear method. Good: constant after a few iterations. Dashed line: iteration "
    "{linear.iterations_to_tolerance}, after which no parameter changed by more than 0.1 %.",
)
def wheel_convergence(solution: Solution, _: Extraction) -> str:
    """Right wheel radius rR and wheel separation b over the iterations (paper's Fig. 5)."""
    history, cameras = solution.linear.history, solution.cameras
    numbers = np.stack([lengths_mm(parameters, cameras) for parameters in history])
    rounds = np.arange(1, len(history) + 1)
    canvas = Canvas(WIDE, 210.0, "wheel radius and separation over the iterations")
    for k, (column, title) in enumerate(((3, "right wheel radius [mm]"), (5, "wheel separation [mm]"))):
        values = numbers[:, column]
        box = (k * WIDE / 2, 0.0, (k + 1) * WIDE / 2, 210.0)
        axes = Axes.of(canvas, _rounds(solution), Limits.of(values, margin=0.25), title, box)
        axes.grid("iteration", whole=True)
        _tolerance(axes, solution)
        _line_with_dots(axes, np.column_stack([rounds, values]), "blue")
    return canvas.svg


@plot(
    "convergence",
    "Difference of each parameter from its final value. Good: lines that become smaller, on this logarithmic "
    "scale nearly straight. A line that rises at first is normal.",
)
def all_convergence(solution: Solution, _: Extraction) -> str:
    """Difference of each of the nine parameters from its final value, over the iterations."""
    history, cameras = solution.linear.history, solution.cameras
    numbers = np.stack([lengths_mm(parameters, cameras) for parameters in history])
    R = np.stack([reference_pose(parameters, cameras)[:3, :3] for parameters in history])
    turned = np.degrees([se3.log_so3(each @ R[-1].T) for each in R])
    apart = np.abs(np.concatenate([turned, numbers - numbers[-1]], axis=1))
    names = (*"xyzxyz", *(parameter.name.removeprefix("radius_") for parameter in PARAMETERS[6:]))
    rounds = np.arange(1, len(numbers) + 1)
    canvas = Canvas(WIDE, 250.0, "difference of each parameter from its final value, over the iterations")
    for k, title in enumerate(("rotation [deg]", "translation [mm]", "wheels [mm]")):
        part = apart[:, 3 * k : 3 * k + 3]
        part = np.where(part > 1e-7, part, np.nan)
        if not np.isfinite(part).any():
            continue
        y = Limits(10 ** np.floor(np.log10(np.nanmin(part))), 10 ** np.ceil(np.log10(np.nanmax(part))), True)
        left = k * WIDE / 3
        axes = Axes.of(canvas, _rounds(solution), y, title, (left, 18.0, left + WIDE / 3, 250.0))
        axes.grid("iteration", whole=True)
        _tolerance(axes, solution)
        styles = list(zip(("blue", "orange", "green"), names[3 * k : 3 * k + 3], strict=True))
        for column, (color, _) in enumerate(styles):
            _line_with_dots(axes, np.column_stack([rounds, part[:, column]]), color)
        shown = [(f"line {color}", name) for color, name in styles]
        wide = Canvas(left + WIDE / 3, 1.0, "")
        wide.legend(shown, left + 8, 16.0)
        canvas.parts += wide.parts
    return canvas.svg


@plot("convergence", "Refinement by {refinement}. Good: the curve reaches a constant value.")
def refinement_convergence(solution: Solution, _: Extraction) -> str:
    """Point error over the iterations of the refinement; "" without a refinement."""
    if solution.refinement is None:
        return ""
    error_mm = solution.refinement.point_rms_history_m * 1e3
    canvas = Canvas(WIDE, 190.0, "point error over the iterations of the refinement")
    axes = Axes.of(
        canvas, Limits(0, max(len(error_mm) - 1, 1)), Limits.of(error_mm, zero=True), "point error [mm]"
    )
    axes.grid("iteration of the refinement (0: linear solution)", whole=True)
    _line_with_dots(axes, np.column_stack([np.arange(len(error_mm)), error_mm]), "blue")
    return canvas.svg


def _rounds(solution: Solution) -> Limits:
    return Limits(1, max(solution.linear.rounds, 2))


def _tolerance(axes: Axes, solution: Solution) -> None:
    at = solution.linear.rounds_to_tolerance
    axes.line([(at, axes.y.low), (at, axes.y.high)], "faint thin dash")


def _line_with_dots(axes: Axes, points: FloatArray, color: str) -> None:
    axes.line(points, color)
    for x, y in points.tolist():
        if np.isfinite(y):
            axes.dot(x, y, color, tip=f"{x:g}: {y:.4g}", r=2.5)


@plot(
    "space",
    "Path of the base with the calibrated wheels (solid) and with the nominal wheels (dotted), and the board "
    "as measured from each station. Good: the green lines coincide (dead reckoning drifts, so they spread "
    "slowly along a long path), the cameras point at the board, and the path is the one that the robot drove.",
    each="log",
)
def seen_from_above(solution: Solution, extraction: Extraction, log: int) -> str:
    """Top view of one recording: path of the base, camera poses, and the board as measured from each station."""
    picked = [i for i, o in enumerate(extraction.observations) if o.log == log]
    seen = [extraction.observations[i] for i in picked]
    T_w_v, T_w_k = solution.residuals.T_w_v[picked], solution.residuals.T_w_k[picked]
    T_w_c = T_w_k @ se3.inverse(np.stack([o.T_c_k for o in seen]))
    board, square_m = extraction.board, float(np.median([o.square_m for o in seen]))
    ends_k = np.array([[-1, board.rows / 2, 0], [board.columns, board.rows / 2, 0]]) * square_m
    boards = se3.act(T_w_k, np.broadcast_to(ends_k, (len(seen), 2, 3)))[..., :2]
    times = np.array([o.time_ns for o in seen])
    path = trail(extraction.wheels[log], times, solution.parameters.wheels)
    everything = np.concatenate([boards.reshape(-1, 2), path, T_w_v[:, :2, 3]])
    canvas = Canvas(WIDE, 420.0, "top view of the base path with cameras and board")
    axes = Axes.equal(canvas, Limits.of(everything[:, 0]), Limits.of(everything[:, 1]), "y [m]", top=18.0)
    axes.grid("x at the first station [m]")
    entries = [("line soft", "path of the base")]
    axes.line(path, "soft")
    nominal = extraction.rig.nominal.wheels
    if nominal is not None:
        axes.line(trail(extraction.wheels[log], times, nominal), "red thin dots")
        entries.append(("line red dots", "with nominal wheels"))
    names, size = station_names(extraction), 0.07 * float(max(np.ptp(everything, axis=0)))
    for k, i in enumerate(picked):
        tip = f"station {names[i]}"
        axes.line(boards[k], "green", [i], f"board from {tip}")
        x_axis, z_axis = T_w_v[k, :2, 0], T_w_c[k, :2, 2]
        at, eye = T_w_v[k, :2, 3], T_w_c[k, :2, 3]
        axes.arrow(at, at + size * x_axis, "blue", [i], tip)
        axes.arrow(eye, eye + size * z_axis / max(float(np.linalg.norm(z_axis)), 1e-9), "orange", [i], tip)
        axes.dot(float(at[0]), float(at[1]), "blue", [i], tip)
    if len(picked) <= _MOST_LABELS:
        axes.named(T_w_v[:, :2, 3], [names[i] for i in picked])
    entries += [("line green", "board"), ("line blue", "base heading"), ("line orange", "camera direction")]
    canvas.legend(entries, 8.0, 16.0)
    return canvas.svg


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


@plot("head", "Head angles at each station. Good: spread in both directions, not along one line.", half=True)
def head_angles(_: Solution, extraction: Extraction) -> str:
    """Pan and tilt angle at each station; "" if the chain names neither joint."""
    chain, seen = extraction.rig.chain, extraction.observations
    columns = [chain.joints.index(name) for name in (chain.pan, chain.tilt) if name in chain.joints]
    if not columns:
        return ""
    joints_deg = np.degrees(np.stack([o.joints for o in seen]))
    pan = joints_deg[:, columns[0]]
    other = joints_deg[:, columns[1]] if len(columns) == 2 else np.zeros(len(seen))
    canvas = Canvas(HALF, 290.0, "head angles at each station")
    labels = [f"{_short(chain.joints[column])} [deg]" for column in columns]
    title = labels[1] if len(columns) == 2 else ""
    spans = (Limits.of(values, margin=0.15, least=_LEAST_SPAN_DEG) for values in (pan, other))
    axes = Axes.of(canvas, next(spans), next(spans), title)
    axes.grid(labels[0])
    names = station_names(extraction)
    for i, (name, x, y) in enumerate(zip(names, pan, other, strict=True)):
        axes.dot(float(x), float(y), "blue", [i], f"station {name}: {x:.1f}, {y:.1f} deg", r=4)
    if len(seen) <= _MOST_LABELS:
        axes.named(np.column_stack([pan, other]), names)
    return canvas.svg


def _short(name: str) -> str:
    shown = visible(name)
    return shown if len(shown) <= 30 else f"{shown[:29]}…"


def image_axes(extraction: Extraction, side: Side, title: str) -> tuple[Canvas, Axes]:
    """Axes over the image of one camera, with its frame: u to the right, v down, px."""
    camera = extraction.rig.cameras.left if side == "left" else extraction.rig.cameras.right
    left, top, wide = 8.0, 26.0, HALF - 16.0
    canvas = Canvas(HALF, top + 6.0 + wide * camera.height / camera.width, title)
    canvas.text(left, 16.0, f"{side} camera", "title")
    axes = Axes(
        canvas,
        Scale(-0.5, camera.width - 0.5, left, left + wide),
        Scale(-0.5, camera.height - 0.5, top, canvas.height - 6.0),
    )
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * [camera.width, camera.height] - 0.5
    axes.line(corners, "faint thin", closed=True)
    return canvas, axes


@plot(
    "coverage",
    "Outlines of the board in the images: corners in {left} and {right} of the image cells. Good: many positions and "
    "sizes, some near the edges.",
    half=True,
    each="side",
)
def picture_coverage(_: Solution, extraction: Extraction, side: Side) -> str:
    """Outlines of the board in the images of one camera."""
    import cv2  # slow to import, and other plots do not need it

    canvas, axes = image_axes(extraction, side, f"outlines of the board in the images of the {side} camera")
    seen, names = extraction.observations, station_names(extraction)
    for i in np.unique(np.linspace(0, len(seen) - 1, min(len(seen), _MOST_OUTLINES)).astype(int)).tolist():
        corners = getattr(seen[i], side)
        measured = corners.pixels[corners.seen]
        if not len(measured):
            continue
        hull = cv2.convexHull(measured.astype(np.float32), returnPoints=False)
        axes.line(measured[hull.ravel()], "blue thin outline", [i], f"station {names[i]}", closed=True)
    return canvas.svg
