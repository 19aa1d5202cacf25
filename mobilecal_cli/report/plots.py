"""The plots of the page, each an <svg> element, "" where there is nothing to show.

A new plot is a function with the decorator `plot`.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.model import (
    NINE,
    Corners,
    Extraction,
    FloatArray,
    Snapshot,
    Solution,
    WheelGeometry,
    WheelTrack,
    camera_words,
)
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.numbers import (
    PARAMETERS,
    parameters_of,
    predicted_point_rms_m,
    reference_pose,
    shown_lengths,
    station_names,
)
from mobilecal_cli.report.svg import HALF, WIDE, Axes, Canvas, Scale
from mobilecal_cli.report.use import FAMILIES, FIGURES, families

_Draw = TypeVar("_Draw", bound=Callable[..., str])
_MOST_PATHS = 4  # recordings with their own plots


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot in a section of the page, or the same plot of several recordings or of both cameras.

    Attributes:
        parts: title ("" for none) and SVG element of each.
        caption: sentences below it; its braces are filled in by `report_html`.
        half: half as wide as the page, side by side.
    """

    section: str
    parts: tuple[tuple[str, str], ...]
    caption: str
    half: bool


@dataclass(frozen=True, slots=True)
class Overlay:
    """The region of an image around the board, as base64 ("" if it cannot be decoded), with marks, for the template.

    Region and marks are in pixels of the whole image; a mark is the corner as detected and as predicted, (u, v) each.
    """

    camera: str
    x: int
    y: int
    width: int
    height: int
    jpeg: str
    marks: list[list[float]]


@dataclass(frozen=True, slots=True)
class LegView:
    """The images of a leg's first station, with the corners predicted from the leg's other end.

    The rank is "worst", "median", "best" or "only"; "" for the others, which the page shows on request.
    """

    observation: int
    rank: str
    from_station: str
    to_station: str
    error_mm: float
    error_px: float
    pictures: tuple[Overlay, ...]


#: What the page shows beside values: plots in the order of their definition, and images of legs.
Drawings: TypeAlias = tuple[tuple[Figure, ...], list[LegView]]
_PLOTS: list[Callable[[Solution, Extraction], Figure]] = []


def plot(
    section: str,
    caption: str = "",
    *,
    half: bool = False,
    each: Literal["log", "camera"] | None = None,
    corners: bool = False,
) -> Callable[[_Draw], _Draw]:
    """Add a function to the plots of the page: solution, data (and log or camera's index) → SVG element, "" for none.

    Args:
        section, caption, half: see `Figure`.
        each: draw it for each recording, or for each camera.
        corners: it is about corners, and is left out where poses were measured in their place.
    """

    def registered(draw: _Draw) -> _Draw:
        def figure(solution: Solution, extraction: Extraction) -> Figure:
            logs = sorted({o.log for o in extraction.observations})
            names = {log: extraction.log_names[log] if len(logs) > 1 else "" for log in logs[:_MOST_PATHS]}
            titles: dict[tuple[Any, ...], str] = {(): ""}  # further arguments of the function → title
            if each is not None:
                cameras = range(len(extraction.rig.cameras.names))
                subjects: Iterable[Any] = names if each == "log" else cameras
                titles = {(subject,): names.get(subject, "") if each == "log" else "" for subject in subjects}
            if corners and extraction.measured:
                titles = {}
            drawn = ((title, draw(solution, extraction, *more)) for more, title in titles.items())
            return Figure(section, tuple(part for part in drawn if part[1]), caption, half)

        _PLOTS.append(figure)
        return draw

    return registered


def draw_all(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot] = ()) -> Drawings:
    """All plots, and the images of those legs whose first station has a snapshot."""
    drawn = [figure(solution, extraction) for figure in _PLOTS] if extraction.observations else []
    return tuple(figure for figure in drawn if figure.parts), leg_views(solution, extraction, snapshots)


_COLORS = ("blue", "orange", "green")
_MOST_VIEWS = 40  # legs with images beside the worst, the median and the best; keeps the page under 5 MB
_VIEW_WIDTH_PX = 640  # wider regions are scaled down; the marks are vectors and stay sharp
_VIEW_MARGIN = 0.3  # around the board, as a share of its size in the image
_MOST_LABELS = 40  # more labels than this are not readable
_MOST_OUTLINES = 150
_TRAIL_POINTS = 400
_LEAST_SPAN_DEG = 20.0  # so that the noise of a fixed head does not look like motion
_MOST_DOTS = 4000  # corners in one scatter
_LEAST_SPAN_SHARE = 0.01  # of an axis of square sizes, so that noise does not look like a difference
_LEAST_SHARE, _LABELED_SHARE = 0.005, 0.08
_OUTLIERS = {"corners": "corners", "station": "station", "slip": "leg (slip)", "joint": "joint reading"}


@plot(
    "convergence",
    "Iterations of the linear method. Good: constant after a few iterations. Dashed line: iteration "
    "{linear.iterations_to_tolerance}, after which no parameter changed by more than 0.1 %.",
)
def wheel_convergence(solution: Solution, extraction: Extraction) -> str:
    """Right wheel radius rR and wheel separation b over the iterations (paper's Fig. 5)."""
    nine = parameters_of(extraction.rig)
    history = solution.linear.history
    numbers = np.stack([shown_lengths(parameters, solution.cameras, nine) for parameters in history])
    canvas = Canvas(WIDE, 210.0, "wheel radius and separation over the iterations")
    for k, (column, title) in enumerate(
        (column, f"{nine[column + 3].label} [{nine[column + 3].shown_unit}]") for column in (3, 5)
    ):
        y = Scale.of(numbers[:, column], margin=0.25)
        box = (k * WIDE / 2, 0.0, (k + 1) * WIDE / 2, 210.0)
        _over_rounds(solution, numbers[:, [column]], Axes.of(canvas, _rounds(solution), y, title, box))
    return canvas.svg


@plot(
    "convergence",
    "Difference of each parameter from its final value. Good: lines that become smaller, on this logarithmic "
    "scale nearly straight. A line that rises at first is normal.",
)
def all_convergence(solution: Solution, extraction: Extraction) -> str:
    """Difference of each of the nine parameters from its final value, over the iterations."""
    history, cameras = solution.linear.history, solution.cameras
    nine = parameters_of(extraction.rig)
    numbers = np.stack([shown_lengths(parameters, cameras, nine) for parameters in history])
    R = np.stack([reference_pose(parameters, cameras)[:3, :3] for parameters in history])
    turned = np.degrees([se3.log_so3(each @ R[-1].T) for each in R])
    apart = np.abs(np.concatenate([turned, numbers - numbers[-1]], axis=1))
    names = (*"xyzxyz", *(parameter.name.removeprefix("radius_") for parameter in PARAMETERS[6:]))
    canvas = Canvas(WIDE, 250.0, "difference of each parameter from its final value, over the iterations")
    for k, title in enumerate(("rotation [deg]", "translation [mm]", f"wheels [{nine[-1].shown_unit}]")):
        part = apart[:, 3 * k : 3 * k + 3]
        part = np.where(part > 1e-7, part, np.nan)
        if not np.isfinite(part).any():
            continue
        y = Scale(10 ** np.floor(np.log10(np.nanmin(part))), 10 ** np.ceil(np.log10(np.nanmax(part))), True)
        left = k * WIDE / 3
        box = (left, 18.0, left + WIDE / 3, 250.0)
        _over_rounds(solution, part, Axes.of(canvas, _rounds(solution), y, title, box))
        wide = Canvas(left + WIDE / 3, 1.0, "")
        entries = zip(_COLORS, names[3 * k : 3 * k + 3], strict=True)
        wide.legend([(f"line {color}", name) for color, name in entries], left + 8, 16.0)
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
        canvas, Scale(0, max(len(error_mm) - 1, 1)), Scale.of(error_mm, zero=True), "point error [mm]"
    )
    axes.grid("iteration of the refinement (0: linear solution)", whole=True)
    _line_with_dots(axes, np.column_stack([np.arange(len(error_mm)), error_mm]), "blue")
    return canvas.svg


def _rounds(solution: Solution) -> Scale:
    return Scale(1, max(solution.linear.rounds, 2))


def _over_rounds(solution: Solution, columns: FloatArray, axes: Axes) -> None:
    """A line for each column of values over the iterations, (n, up to 3), and one at the tolerance."""
    axes.grid("iteration", whole=True)
    at = solution.linear.rounds_to_tolerance
    axes.line([(at, axes.y.low), (at, axes.y.high)], "faint thin dash")
    for color, values in zip(_COLORS, columns.T, strict=False):
        _line_with_dots(axes, np.column_stack([np.arange(1, len(values) + 1), values]), color)


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
    x, y = (Scale.of(column) for column in everything.T)
    axes = Axes.of(canvas, x, y, "y [m]", (0.0, 18.0, WIDE, 420.0)).with_equal_units()
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
        canvas.labels(axes.at(T_w_v[:, :2, 3]), [names[i] for i in picked])
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
    spans = (Scale.of(values, margin=0.15, least=_LEAST_SPAN_DEG) for values in (pan, other))
    axes = Axes.of(canvas, next(spans), next(spans), title)
    axes.grid(labels[0])
    names = station_names(extraction)
    for i, (name, x, y) in enumerate(zip(names, pan, other, strict=True)):
        axes.dot(float(x), float(y), "blue", [i], f"station {name}: {x:.1f}, {y:.1f} deg", r=4)
    if len(seen) <= _MOST_LABELS:
        canvas.labels(axes.at(np.column_stack([pan, other])), names)
    return canvas.svg


def _short(name: str) -> str:
    shown = visible(name)
    return shown if len(shown) <= 30 else f"{shown[:29]}…"


def image_axes(extraction: Extraction, k: int, title: str) -> tuple[Canvas, Axes]:
    """Axes over the image of one camera, with its frame: u to the right, v down, px."""
    cameras = extraction.rig.cameras
    camera = cameras.each[k]
    left, top, wide = 8.0, 26.0, HALF - 16.0
    canvas = Canvas(HALF, top + 6.0 + wide * camera.height / camera.width, title)
    canvas.text(left, 16.0, camera_words(cameras.names[k]), "title")
    axes = Axes(
        canvas,
        Scale(-0.5, camera.width - 0.5, start=left, end=left + wide),
        Scale(-0.5, camera.height - 0.5, start=top, end=canvas.height - 6.0),
    )
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * [camera.width, camera.height] - 0.5
    axes.line(corners, "faint thin", closed=True)
    return canvas, axes


@plot(
    "coverage",
    "Outlines of the board in the images: corners in {coverage} of the image cells. Good: many positions and "
    "sizes, some near the edges.",
    half=True,
    each="camera",
    corners=True,
)
def picture_coverage(_: Solution, extraction: Extraction, k: int) -> str:
    """Outlines of the board in the images of one camera."""
    import cv2  # slow to import, and other plots do not need it

    of_camera = camera_words(extraction.rig.cameras.names[k])
    canvas, axes = image_axes(extraction, k, f"outlines of the board in the images of the {of_camera}")
    seen, names = extraction.observations, station_names(extraction)
    for i in np.unique(np.linspace(0, len(seen) - 1, min(len(seen), _MOST_OUTLINES)).astype(int)).tolist():
        corners = seen[i].views[k]
        measured = corners.pixels[corners.seen]
        if not len(measured):
            continue
        hull = cv2.convexHull(measured.astype(np.float32), returnPoints=False)
        axes.line(measured[hull.ravel()], "blue thin outline", [i], f"station {names[i]}", closed=True)
    return canvas.svg


@plot(
    "residuals",
    "One bar per leg. Good: bars of similar height. One bar far above the others: a wheel slipped or the "
    "board moved on that leg. All bars far above the dashed line: errors of the wheels or of the head joints "
    "are larger than the depth noise of the cameras.",
)
def leg_residuals(solution: Solution, extraction: Extraction) -> str:
    """Point error and reprojection error of each leg."""
    residuals, names = solution.residuals, station_names(extraction)
    if not len(residuals.legs):
        return ""
    point_mm, depth_mm = residuals.leg_point_rms_m * 1e3, predicted_point_rms_m(extraction, solution) * 1e3
    legs = [(f"{names[i]}–{names[j]}", (i, j)) for i, j in residuals.legs.tolist()]
    canvas = Canvas(WIDE, 440.0, "point error and reprojection error of each leg")
    for top, title, values, unit, whole in (
        (14.0, "point error [mm]", point_mm, "mm", solution.point_rms_m * 1e3),
        (230.0, "reprojection error [px]", residuals.leg_reprojection_px, "px", solution.reprojection_rms_px),
    ):
        y = Scale.of([*values, whole, depth_mm if unit == "mm" else 0.0], zero=True)
        axes = Axes.of(canvas, Scale(-0.6, len(legs) - 0.4), y, title, (0.0, top, WIDE, top + 210.0))
        axes.grid(x=False)
        for k, ((name, ends), value) in enumerate(zip(legs, values.tolist(), strict=True)):
            axes.bar(k, value, "blue", ends, f"{name}: {value:.2f} {unit}")
        axes.level(whole, "ink thin")
        if unit == "mm":
            axes.level(depth_mm, "orange dash")
        axes.names([name for name, _ in legs], "leg (from station–to station)" if unit == "px" else "")
    canvas.legend([("line ink thin", "all legs"), ("line orange dash", "depth noise alone")], 300.0, 16.0)
    return canvas.svg


@plot(
    "residuals",
    "Residuals over time, with outliers and rejected stations at the bottom. Good: no trend, and outliers "
    "with a known cause.",
    each="log",
)
def over_time(solution: Solution, extraction: Extraction, log: int) -> str:
    """Leg and stereo residuals of one recording over time, with outliers and rejected stations."""
    seen, residuals, names = extraction.observations, solution.residuals, station_names(extraction)
    mine = [leg for leg, (i, _) in enumerate(residuals.legs) if seen[i].log == log]
    stations = [(i, o) for i, o in enumerate(seen) if o.log == log]
    rejected = [r for r in extraction.rejections if r.log == log and r.time_ns]
    outliers = [o for o in solution.outliers if o.log == log]
    start = min([o.time_ns for _, o in stations] + [r.time_ns for r in rejected])
    times = [o.time_ns for _, o in stations]
    times += [r.time_ns for r in rejected] + [o.time_ns for o in outliers]
    values = [*residuals.leg_reprojection_px[mine], *(o.reprojection_px for _, o in stations)]
    entries = [("line blue", "legs"), ("line green", "images alone")]
    entries += [("line red", f"outlier: {_OUTLIERS[kind]}") for kind in sorted({o.kind for o in outliers})]
    if rejected:
        entries.append(("line ink", "rejected image or station"))
    canvas = Canvas(WIDE, 290.0, "residuals over time, with outliers and rejected stations")
    top = canvas.legend(entries, 8.0, 16.0)
    x = Scale.of([(t - start) * 1e-9 for t in times])
    axes = Axes.of(canvas, x, Scale.of(values, zero=True), "residual [px]", (0.0, top + 8.0, WIDE, 290.0))
    axes.grid("time since the first station [s]")
    for leg in mine:
        i, j = residuals.legs[leg].tolist()
        px = float(residuals.leg_reprojection_px[leg])
        ends = [((seen[k].time_ns - start) * 1e-9, px) for k in (i, j)]
        axes.line(ends, "blue", [i, j], f"{names[i]}–{names[j]}: {px:.2f} px")
    for i, o in stations:
        tip = f"station {names[i]}: {o.reprojection_px:.2f} px"
        axes.dot((o.time_ns - start) * 1e-9, o.reprojection_px, "green", [i], tip, r=3)
    bottom, room = axes.y.low, 0.05 * (axes.y.high - axes.y.low)
    for r in rejected:
        at = (r.time_ns - start) * 1e-9
        axes.line([(at, bottom), (at, bottom + room)], "ink", tip=r.reason)
    for outlier in outliers:
        at = (outlier.time_ns - start) * 1e-9
        axes.line([(at, bottom), (at, bottom + 2 * room)], "red", outlier.observations, outlier.text)
    return canvas.svg


@plot(
    "residuals",
    "The images alone, without robot motion. Good: residuals of about 0.3 px or less{squares}. High residuals at all "
    "stations: camera_info does not match the cameras. Square size different from the stated one: the baseline or the "
    "stated size is wrong.",
    corners=True,
)
def station_residuals(_: Solution, extraction: Extraction) -> str:
    """Residual of the flat board in the images, and the square size that a stereo pair measures, at each station."""
    seen, names = extraction.observations, station_names(extraction)
    square_mm = [o.square_m * 1e3 for o in seen]
    stated = [] if extraction.board.square_m is None else [extraction.board.square_m * 1e3]
    x = Scale(-0.6, len(seen) - 0.4)
    pair = extraction.rig.cameras.calibrated
    what = "residual and square size" if pair else "residual"
    canvas = Canvas(WIDE, 420.0 if pair else 210.0, f"{what} at each station")
    residual = Scale.of([o.reprojection_px for o in seen], zero=True)
    axes = Axes.of(canvas, x, residual, "residual of the flat board [px]", (0.0, 0.0, WIDE, 200.0))
    axes.grid(x=False)
    for i, o in enumerate(seen):
        axes.bar(i, o.reprojection_px, "green", [i], f"station {names[i]}: {o.reprojection_px:.3f} px")
    axes.names(names, "" if pair else "station")
    if not pair:
        return canvas.svg
    size = Scale.of([*square_mm, *stated], margin=0.3, least=_LEAST_SPAN_SHARE * square_mm[0])
    axes = Axes.of(canvas, x, size, "measured square size [mm]", (0.0, 210.0, WIDE, 420.0))
    axes.grid(x=False)
    for value in stated:
        axes.level(value, "ink thin")
        canvas.legend([("line ink thin", "stated")], 300.0, 226.0)
    for i, value in enumerate(square_mm):
        axes.dot(i, value, "green", [i], f"station {names[i]}: {value:.2f} mm", r=4)
    axes.names(names, "station")
    return canvas.svg


@plot(
    "residuals",
    "Corner residuals across the image, magnified. Good: lines point in random directions. Lines that circle "
    "the image center or point away from it: camera_info does not match the lens.",
    half=True,
    each="camera",
    corners=True,
)
def picture_residuals(_: Solution, extraction: Extraction, k: int) -> str:
    """Residuals of the corners from the fitted flat board over the image, one line per corner, magnified.

    The board's pose at each station comes from the cameras, so the robot's motion has no influence.
    """
    found = [_board_residuals(extraction, k, i) for i in range(len(extraction.observations))]
    lengths = np.concatenate([np.linalg.norm(r, axis=1) for _, r in found])
    if not len(lengths):
        return ""
    of_camera = camera_words(extraction.rig.cameras.names[k])
    canvas, axes = image_axes(extraction, k, f"corner residuals across the image of the {of_camera}")
    longest = float(np.percentile(lengths, 95))
    scale = 0.04 * abs(axes.x.high - axes.x.low) / longest if longest else 1.0
    every = max(1, sum(len(pixels) for pixels, _ in found) // _MOST_DOTS)
    names = station_names(extraction)
    for i, (pixels, residual) in enumerate(found):
        lines = np.stack([pixels, pixels + scale * residual, np.full_like(pixels, np.nan)], axis=1)[::every]
        axes.line(lines.reshape(-1, 2), "blue thin", [i], f"station {names[i]}")
    canvas.text(canvas.width - 10, 16, f"magnified {scale:.0f} times", anchor="end")
    return canvas.svg


@plot(
    "residuals",
    "All corner residuals. Good: one symmetric peak at zero.",
    corners=True,
)
def residual_histogram(_: Solution, extraction: Extraction) -> str:
    """How often the corners are off by how much from the fitted flat board, u and v of all cameras."""
    stations = range(len(extraction.observations))
    cameras = range(len(extraction.rig.cameras.names))
    values = np.concatenate([_board_residuals(extraction, k, i)[1] for k in cameras for i in stations])
    most = float(np.percentile(np.abs(values), 99.5)) or 1.0
    counts, edges = np.histogram(values, bins=41, range=(-most, most))
    share = 100 * counts / values.size
    canvas = Canvas(WIDE, 200.0, "histogram of the corner residuals")
    axes = Axes.of(
        canvas, Scale(-most, most), Scale.of(share, zero=True), "corner residuals, share of all [%]"
    )
    axes.grid("residual of a coordinate [px]")
    left, right = edges[:-1], edges[1:]
    steps = np.stack([left, share, right, share], axis=1).reshape(-1, 2)
    axes.line(np.concatenate([[[left[0], 0.0]], steps, [[right[-1], 0.0]]]), "blue")
    return canvas.svg


def _board_residuals(extraction: Extraction, k: int, i: int) -> tuple[FloatArray, FloatArray]:
    """Detected corners of a station, (n, 2), and their residuals from the fitted board, (n, 2), px."""
    cameras, o = extraction.rig.cameras, extraction.observations[i]
    corners, T = o.views[k], se3.inverse(cameras.T_c_each[k])
    points = se3.act(T @ o.T_c_k, extraction.board.grid()[corners.seen] * o.square_m)
    measured = corners.pixels[corners.seen]
    return measured, measured - project(cameras.each[k], points)


@plot(
    "correlation",
    "Blue: positive correlation; orange: negative. Near ±1 the recording determines a combination of the two "
    "parameters better than each one alone. More varied motion separates them.",
)
def correlation_matrix(solution: Solution, _: Extraction) -> str:
    """Correlation matrix of the nine parameters; "" without a covariance."""
    found = solution.uncertainty
    if found is None:
        return ""
    std = np.sqrt(np.diag(found.reference_covariance))
    std = np.where(std > 0, std, np.nan)
    correlation = found.reference_covariance / np.outer(std, std)
    canvas = Canvas(WIDE, 370.0, "correlation matrix of the nine parameters")
    left, top, wide, high = 100.0, 6.0, 58.0, 32.0
    for k, name in enumerate(NINE):
        canvas.text(left - 8, top + (k + 0.6) * high, name, anchor="end")
        x, y = left + (k + 0.5) * wide, top + 9 * high + 14
        canvas.text(x, y, name, anchor="end", turn=-30)
    for (i, j), value in np.ndenumerate(correlation):
        if np.isfinite(value):
            x, y, kind = left + j * wide, top + i * high, f"fill {'blue' if value > 0 else 'orange'}"
            shade = 0.6 * min(1.0, abs(value))
            canvas.shape("rect", kind, x=x, y=y, width=wide - 1, height=high - 1, fill_opacity=shade)
            canvas.text(x + wide / 2, y + high / 2 + 4, f"{value:+.2f}" if i != j else "1", anchor="middle")
    return canvas.svg


@plot(
    "budget",
    "What each variance consists of. Dark: noise of the measurements, which more stations reduce. Light: "
    "uncertainty of the robot description, which only better stated values reduce.",
)
def error_budget(solution: Solution, _: Extraction) -> str:
    """What each variance consists of, one bar per parameter and expected error; "" without a budget."""
    found = solution.uncertainty
    if found is None:
        return ""
    names, shares = families(solution)
    at_work = [figure for figure in FIGURES if figure.limit is not None]
    fields = [*NINE, *found.budget.at_work]
    columns = [*range(len(NINE)), *(fields.index(figure.field) for figure in at_work)]
    labels = [*NINE, *(figure.short for figure in at_work)]
    used = [k for k in range(len(names)) if shares[k, columns].max() > _LEAST_SHARE]
    canvas = Canvas(WIDE, 60.0 + 24.0 * len(labels), "error budget: what each variance consists of")
    left, wide = 122.0, WIDE - 132.0
    canvas.legend([(f"fill {FAMILIES[names[k]].style}", names[k]) for k in used], 8.0, 14.0)
    for row, (label, column) in enumerate(zip(labels, columns, strict=True)):
        y, x = 46.0 + 24.0 * row, left
        canvas.text(left - 8, y + 13, label, anchor="end")
        for k in used:
            width = wide * float(shares[k, column])
            if width <= 0:
                continue
            share, kind = f"{100 * shares[k, column]:.0f} %", f"fill {FAMILIES[names[k]].style}"
            canvas.shape("rect", kind, (), f"{label}: {names[k]} {share}", x=x, y=y, width=width, height=18)
            if shares[k, column] > _LABELED_SHARE:
                canvas.text(x + width / 2, y + 13, share, anchor="middle")
            x += width
    return canvas.svg


def leg_views(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot]) -> list[LegView]:
    """The worst, the median and the best leg among those whose first station has images, and up to 40 others."""
    residuals, seen = solution.residuals, extraction.observations
    cameras = extraction.rig.cameras
    pictures = {(s.log, s.station): s for s in snapshots}
    shown = [leg for leg, (i, _) in enumerate(residuals.legs) if (seen[i].log, seen[i].station) in pictures]
    order = sorted(shown, key=lambda leg: (-residuals.leg_reprojection_px[leg], leg))
    if not order:
        return []
    chosen = dict.fromkeys([order[0], order[len(order) // 2], order[-1]])
    words = {1: ("only",), 2: ("worst", "best")}.get(len(chosen), ("worst", "median", "best"))
    ranks = dict(zip(chosen, words, strict=True))
    others = [leg for leg in shown if leg not in ranks]
    others = others[:: max(1, math.ceil(len(others) / _MOST_VIEWS))]
    names = station_names(extraction)
    views = []
    for leg in (*ranks, *others):
        i, j = residuals.legs[leg]
        snapshot = pictures[seen[i].log, seen[i].station]
        views.append(
            LegView(
                observation=int(i),
                rank=ranks.get(leg, ""),
                from_station=names[i],
                to_station=names[j],
                error_mm=float(residuals.leg_point_rms_m[leg] * 1e3),
                error_px=float(residuals.leg_reprojection_px[leg]),
                pictures=tuple(
                    _overlay(
                        camera_words(name),
                        snapshot.jpegs.get(name, b""),
                        view,
                        residuals.predicted_px[k, leg],
                    )
                    for k, (name, view) in enumerate(zip(cameras.names, seen[i].views, strict=True))
                    if view.pictures or cameras.calibrated
                ),
            )
        )
    return views


def _overlay(camera: str, jpeg: bytes, corners: Corners, predicted: FloatArray) -> Overlay:
    import cv2  # slow to import

    detected, predicted = corners.pixels[corners.seen], predicted[corners.seen]
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE) if jpeg else None
    marks = np.concatenate([detected, predicted], axis=1) + 0.5  # SVG coordinates start at a pixel's edge
    shown = detected if len(detected) else corners.pixels  # where the board is, as the other camera sees it
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = _VIEW_MARGIN * float(np.max(high - low)) + 8
    bounds = np.array([[0, 0], [1 << 20, 1 << 20]] if picture is None else [[0, 0], picture.shape[::-1]])
    (x, y), (right, bottom) = np.clip([low - margin, high + margin], *bounds).astype(int).tolist()
    place = (camera, x, y, right - x, bottom - y)
    if picture is None:
        return Overlay(*place, "", np.round(marks, 2).tolist())
    part = picture[y:bottom, x:right]
    if part.shape[1] > _VIEW_WIDTH_PX:
        size = (_VIEW_WIDTH_PX, max(1, round(part.shape[0] * _VIEW_WIDTH_PX / part.shape[1])))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", part, [cv2.IMWRITE_JPEG_QUALITY, 72])[1]
    return Overlay(*place, base64.b64encode(encoded.tobytes()).decode("ascii"), np.round(marks, 2).tolist())
