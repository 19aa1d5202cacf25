"""The plots of the page, each an <svg> element.

A new plot is a function with the decorator `plot`. The first screen has `path_picture` and `budget_bar`.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.likelihood.predict import AHEAD_M, projection_std_px
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import Corners, Extraction, Snapshot
from mobilecal_cli.model.rig import WheelGeometry, camera_words
from mobilecal_cli.model.solution import Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.numbers import CELLS, image_coverage, station_names, std_text
from mobilecal_cli.report.svg import HALF, NARROW, WIDE, Axes, Canvas, Scale
from mobilecal_cli.report.use import FAMILIES, FIGURES, Error, family_shares, shares_of

_MOST_PATHS = 4  # recordings with their own plots


class Drawn(NamedTuple):
    """An SVG element, its caption (what it shows, from its numbers), and a title above it."""

    svg: str
    caption: str = ""
    title: str = ""


class Overlay(NamedTuple):
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


class LegView(NamedTuple):
    """The images of a leg's first station (observation), with the corners predicted from the leg's other end."""

    observation: int
    title: str
    pictures: tuple[Overlay, ...]


class Thumbnail(NamedTuple):
    """A small image of a station, as base64; the observation is -1 and the reason is given where it is not used."""

    observation: int
    station: str
    jpeg: str
    reason: str


_Draw: TypeAlias = Callable[[Solution, Extraction], Iterator[Drawn]]
_PLOTS: list[tuple[str, bool, _Draw]] = []


def plot(section: str, *, half: bool = False) -> Callable[[_Draw], _Draw]:
    """Add a function to the plots of a section of the page; half as wide as the page, side by side, if `half`.

    It yields nothing where there is nothing to show.
    """

    def registered(draw: _Draw) -> _Draw:
        _PLOTS.append((section, half, draw))
        return draw

    return registered


def plots(solution: Solution, extraction: Extraction) -> list[tuple[str, bool, Drawn]]:
    """All plots that have something to show, in the order of their definition: section, whether half as wide, plot."""
    return [(section, half, drawn) for section, half, draw in _PLOTS for drawn in draw(solution, extraction)]


SHOWN_LEGS = 3  # of which the page shows the images; those of others on request
_MOST_VIEW_BYTES = 400_000  # of the images of legs, so that the page stays under 1 MB
_VIEW_WIDTH_PX = 480  # wider regions are scaled down; the marks are vectors and stay sharp
_VIEW_MARGIN = 0.3  # around the board, as a share of its size in the image
_MOST_OUTLINES = 150  # of boards in one image, so that the page stays small
_VISIBLE_M = 0.01  # in a picture of a drive: a pixel
_TRAIL_POINTS = 400  # of a path: more are finer than a pixel
_LEAST_SPAN_DEG = 20.0  # so that the noise of a fixed head does not look like motion
_MOST_DOTS = 4000  # corners in one scatter
_MARK_BYTES = 160  # of a detected and a predicted corner in the page
_LEAST_SHARE, _LABELED_SHARE = 0.005, 0.08  # of a bar: less is no pixel wide, or too narrow for a label


@plot("stations", half=True)
def further_paths(solution: Solution, extraction: Extraction) -> Iterator[Drawn]:
    """Top views of the recordings but the first, which is on the first screen."""
    for log in sorted({o.log for o in extraction.observations})[1:_MOST_PATHS]:
        yield path_picture(solution, extraction, log)._replace(title=extraction.log_names[log])


def path_picture(solution: Solution, extraction: Extraction, log: int | None = None) -> Drawn:
    """Top view of a recording, or the first: path of the base, cameras, and the board as measured at each station."""
    log = min(o.log for o in extraction.observations) if log is None else log
    picked = [i for i, o in enumerate(extraction.observations) if o.log == log]
    observations, board = [extraction.observations[i] for i in picked], extraction.board
    residuals = solution.residuals
    T_w_v, T_w_c, T_w_k = (of[picked] for of in (residuals.T_w_v, residuals.T_w_c, residuals.T_w_k))
    ends_k = np.array([[-1, board.rows / 2, 0], [board.columns, board.rows / 2, 0]])
    ends_k *= float(np.median([o.square_m for o in observations]))
    boards = se3.act(T_w_k, np.broadcast_to(ends_k, (len(picked), 2, 3)))[..., :2]
    path = trail(extraction, log, solution.parameters.wheels)
    everything = np.concatenate([boards.reshape(-1, 2), path, T_w_v[:, :2, 3]])
    canvas = Canvas(HALF, 0.85 * HALF, "top view of the base path with cameras and board")
    left, low = 10.0, canvas.height - 22.0
    x, y = (Scale.of(column) for column in everything.T)
    x, y = replace(x, start=left, end=HALF - left), replace(y, start=low, end=24.0)
    axes = Axes(canvas, x, y).with_equal_units()
    entries = [("line green", "board"), ("line orange", "camera")]
    axes.line(path, "soft")
    nominal, caption = extraction.rig.nominal.wheels, ""
    if nominal is not None:
        without = trail(extraction, log, nominal)
        axes.clipped_line(without, "red thin dots")
        entries.append(("line red dots", "nominal"))
        apart = float(np.linalg.norm(without[-1] - path[-1]))
        if apart >= _VISIBLE_M:
            caption = f"With the nominal wheels, the path ends {apart:.2f} m from here."
    names, size = station_names(extraction), 0.07 * float(max(np.ptp(everything, axis=0)))
    for k, i in enumerate(picked):
        tip, at, eye, z_axis = f"station {names[i]}", T_w_v[k, :2, 3], T_w_c[k, :2, 3], T_w_c[k, :2, 2]
        axes.line(boards[k], "green thin", [i], f"board from {tip}")
        axes.arrow(eye, eye + size * z_axis / max(float(np.linalg.norm(z_axis)), 1e-9), "orange", [i], tip)
        axes.dot(float(at[0]), float(at[1]), "blue", [i], tip, r=3)
    meter = axes.x(1.0) - axes.x(0.0)
    canvas.path(np.array([[left, low + 14], [left + meter, low + 14]]), "line ink")
    canvas.text(left + meter + 6, low + 18, "1 m")
    canvas.legend(entries, 8.0, 12.0)
    return Drawn(canvas.svg, caption)


def trail(extraction: Extraction, log: int, wheels: WheelGeometry) -> FloatArray:
    """Path of the base in a recording by dead reckoning, in the frame of its first station: (n, 2), m."""
    times_ns = [o.time_ns for o in extraction.observations if o.log == log]
    track = extraction.wheels[log]
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


@plot("stations", half=True)
def head_angles(_: Solution, extraction: Extraction) -> Iterator[Drawn]:
    """Pan and tilt angle at each station; nothing if the chain names neither joint."""
    chain, observations = extraction.rig.chain, extraction.observations
    columns = [chain.joints.index(name) for name in (chain.pan, chain.tilt) if name in chain.joints]
    if not columns:
        return
    joints_deg = np.degrees(np.stack([o.joints for o in observations]))
    pan = joints_deg[:, columns[0]]
    other = joints_deg[:, columns[1]] if len(columns) == 2 else np.zeros(len(observations))
    canvas = Canvas(HALF, 290.0, "head angles at each station")
    joints = [visible(chain.joints[column]) for column in columns]
    labels = [f"{joint if len(joint) <= 30 else f'{joint[:29]}…'} [deg]" for joint in joints]
    title = labels[1] if len(columns) == 2 else ""
    scales = (Scale.of(values, margin=0.15, least=_LEAST_SPAN_DEG) for values in (pan, other))
    axes = Axes.of(canvas, next(scales), next(scales), title)
    axes.grid(labels[0])
    names = station_names(extraction)
    for i, (name, x, y) in enumerate(zip(names, pan, other, strict=True)):
        axes.dot(float(x), float(y), "blue", [i], f"station {name}: {x:.1f}, {y:.1f} deg", r=4)
    spans = zip(labels, (pan, other), strict=False)
    ranges = (f"{label.partition(' [')[0]} {np.ptp(angles):.0f}°" for label, angles in spans)
    yield Drawn(canvas.svg, f"Range: {', '.join(ranges)}.")


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


@plot("stations")
def leg_residuals(solution: Solution, extraction: Extraction) -> Iterator[Drawn]:
    """Point error and reprojection error of each leg as bars, with those of all legs as lines."""
    residuals, names = solution.residuals, station_names(extraction)
    if not len(residuals.legs):
        return
    ends = residuals.legs.tolist()
    legs, errors_px = [f"{names[i]}–{names[j]}" for i, j in ends], residuals.leg_reprojection_px
    canvas = Canvas(WIDE, 430.0, "point error and reprojection error of each leg")
    noise = "noise of the poses alone" if extraction.measured else "depth noise alone"
    of_points = [("ink thin", "all legs", solution.point_rms_m * 1e3)]
    of_points.append(("orange dash", noise, residuals.corner_noise_m * 1e3))
    of_pixels = [("ink thin", "all legs", solution.reprojection_rms_px)]
    for top, title, unit, errors, levels, x_label in (
        (0.0, "point error", "mm", residuals.leg_point_rms_m * 1e3, of_points, ""),
        (216.0, "reprojection error", "px", errors_px, of_pixels, "leg (from station–to station)"),
    ):
        values = errors.tolist()
        y = Scale.of([*values, *(value for _, _, value in levels)], zero=True)
        box = (0.0, top, WIDE, top + 210.0)
        axes = Axes.of(canvas, Scale(-0.6, len(legs) - 0.4), y, f"{title} [{unit}]", box)
        axes.grid(x=False)
        for k, (leg, value, stations) in enumerate(zip(legs, values, ends, strict=True)):
            axes.bar(k, value, "blue", stations, f"{leg}: {value:.3g} {unit}")
        for style, _, value in levels:
            axes.level(value, style)
        canvas.legend([(f"line {style}", label) for style, label, _ in levels], 300.0, top + 16.0)
        axes.names(legs, x_label)
    worst, median = int(np.argmax(errors_px)), float(np.median(errors_px))
    times = float(errors_px[worst]) / median if median else 1.0
    yield Drawn(canvas.svg, f"Largest: leg {legs[worst]}, {times:.1f} times the median reprojection error.")


@plot("description", half=True)
def corner_residuals(_: Solution, extraction: Extraction) -> Iterator[Drawn]:
    """Board in the images of each camera: outlines, and the residuals of the corners, one line each, magnified.

    Residuals are from the fitted flat board, whose pose at each station comes from the cameras, so the robot's motion
    has no influence.
    """
    import cv2  # slow to import, and other plots do not need it

    for k in () if extraction.measured else range(len(extraction.rig.cameras.names)):
        of_station = [_board_residuals(extraction, k, i) for i in range(len(extraction.observations))]
        detected, residuals = (np.concatenate(each) for each in zip(*of_station, strict=True))
        if not len(detected):
            continue
        of_camera = camera_words(extraction.rig.cameras.names[k])
        canvas, axes = image_axes(extraction, k, f"corner residuals across the image of the {of_camera}")
        longest = float(np.percentile(np.linalg.norm(residuals, axis=1), 95))
        scale = 0.04 * abs(axes.x.high - axes.x.low) / longest if longest else 1.0
        every = max(1, len(detected) // _MOST_DOTS)
        outlined = max(1, len(of_station) // _MOST_OUTLINES)
        each_station = zip(station_names(extraction), of_station, strict=True)
        for i, (name, (pixels, residual)) in enumerate(each_station):
            if len(pixels) and i % outlined == 0:
                hull = cv2.convexHull(pixels.astype(np.float32), returnPoints=False)
                axes.line(pixels[hull.ravel()], "faint thin", [i], f"station {name}", closed=True)
            lines = np.stack([pixels, pixels + scale * residual, np.full_like(pixels, np.nan)], axis=1)
            axes.line(lines[::every].reshape(-1, 2), "blue thin", [i], f"station {name}")
        canvas.text(canvas.width - 10, 16, f"magnified {scale:.0f} times", anchor="end")
        share = 100 * image_coverage(extraction, k)
        yield Drawn(canvas.svg, f"The board covers {share:.0f} % of the images of the {of_camera}.")


def _board_residuals(extraction: Extraction, k: int, i: int) -> tuple[FloatArray, FloatArray]:
    """Detected corners of a station, (n, 2), and their residuals from the fitted board, (n, 2), px."""
    cameras, o = extraction.rig.cameras, extraction.observations[i]
    corners, T = o.views[k], se3.inverse(cameras.T_c_each[k])
    points = se3.act(T @ o.T_c_k, extraction.board.grid()[corners.seen] * o.square_m)
    measured = corners.pixels[corners.seen]
    return measured, measured - project(cameras.each[k], points)


@plot("limits", half=True)
def projection_map(solution: Solution, extraction: Extraction) -> Iterator[Drawn]:
    """1 sigma of the pixel of a point that is known in the base, over the image of the first camera."""
    if solution.uncertainty is None or extraction.measured:
        return
    camera, name = solution.cameras.each[0], camera_words(extraction.rig.cameras.names[0])
    (across, down) = CELLS
    u = (np.arange(across) + 0.5) * camera.width / across - 0.5
    v = (np.arange(down) + 0.5) * camera.height / down - 0.5
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    flat, reached = undistorted(camera, pixels)
    points = AHEAD_M * np.column_stack([flat, np.ones(len(flat))])
    std = projection_std_px(solution, extraction.rig.cameras, points)
    title = f"1 sigma in pixels of a projected point over the image of the {name}"
    canvas, axes = image_axes(extraction, 0, title)
    wide, high = abs(axes.x(u[1]) - axes.x(u[0])), abs(axes.y(v[1]) - axes.y(v[0]))
    for (x, y), sigma in zip(axes.at(pixels[reached]).tolist(), std[reached].tolist(), strict=True):
        shade, left, top = 0.6 * sigma / max(std[reached]), x - wide / 2, y - high / 2
        canvas.shape("rect", "fill blue", x=left, y=top, width=wide, height=high, fill_opacity=shade)
        canvas.text(x, y + 4, std_text(sigma), anchor="middle")
    extent = f"{std_text(min(std))} to {std_text(max(std))}"
    yield Drawn(canvas.svg, f"Pixel of a point {AHEAD_M:g} m ahead, 1 sigma in px: {extent}.")


def _stack(
    canvas: Canvas,
    box: tuple[float, float, float, float],
    shares: Sequence[tuple[float, str]],
    labels: bool = True,
) -> None:
    """Shares of groups of sources, (share, group), side by side in a box: left, top, width and height."""
    x, y, wide, high = box
    for share, family in shares:
        tip = f"{family} {100 * share:.0f} %"
        kind, width = f"fill {FAMILIES[family].style}", wide * share
        canvas.shape("rect", kind, (), tip, x=x, y=y, width=width, height=high)
        if labels and share > _LABELED_SHARE:
            canvas.text(x + width / 2, y + high / 2 + 4, f"{100 * share:.0f} %", anchor="middle")
        x += width


@plot("limits")
def error_budget(solution: Solution, _: Extraction) -> Iterator[Drawn]:
    """What each variance consists of, one bar per parameter and expected error; nothing without a budget."""
    if solution.uncertainty is None:
        return
    labels = {name: name for name in NINE}
    labels |= {figure.field: figure.short for figure in FIGURES if figure.limit is not None}
    budget = solution.uncertainty.budget
    shares = {name: {f: s for s, f in family_shares(shares_of(budget, name))} for name in labels}
    used = [f for f in FAMILIES if max(of.get(f, 0.0) for of in shares.values()) > _LEAST_SHARE]
    canvas = Canvas(WIDE, 60.0 + 24.0 * len(labels), "error budget: what each variance consists of")
    canvas.legend([(f"fill {FAMILIES[family].style}", family) for family in used], 8.0, 14.0)
    for row, (name, label) in enumerate(labels.items()):
        y, of = 46.0 + 24.0 * row, shares[name]
        canvas.text(114.0, y + 13, label, anchor="end")
        _stack(canvas, (122.0, y, WIDE - 132.0, 18.0), [(of[f], f) for f in used if f in of])
    yield Drawn(
        canvas.svg, "Strong colors: noise of the measurements. Weak colors: uncertainty of stated values."
    )


def budget_bar(error: Error) -> Drawn:
    """What the variance of one expected error consists of."""
    largest = [(share, name) for share, name in family_shares(error.shares) if name != "other"][:3]
    used = [(share, name) for share, name in largest if share > _LABELED_SHARE / 2]
    rest = 1 - sum(share for share, _ in used)
    used += [(rest, "other")] * (rest > _LEAST_SHARE)
    canvas = Canvas(NARROW, 0.0, f"error budget of the {error.figure.meaning}")
    _stack(canvas, (0.0, 0.0, NARROW, 16.0), used, labels=False)
    labels = [(f"fill {FAMILIES[name].style}", f"{name} {100 * s:.0f} %") for s, name in used]
    canvas.height = canvas.legend(labels, 0.0, 32.0) + 4
    value = f"{std_text(error.value)} {error.figure.unit}, limit {error.limit:.3g}"
    return Drawn(canvas.svg, title=f"What limits the {error.figure.short} ({value})")


def leg_views(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot]) -> list[LegView]:
    """The legs whose first station has images, the largest error first, as many as fit."""
    residuals, observations = solution.residuals, extraction.observations
    pictures = {(s.log, s.station): s for s in snapshots if s.jpegs}
    first = [(observations[i].log, observations[i].station) for i in residuals.legs[:, 0]]
    names, size = station_names(extraction), 0
    views: list[LegView] = []
    for leg in np.argsort(-residuals.leg_reprojection_px, kind="stable").tolist():
        if first[leg] not in pictures:
            continue
        if len(views) >= SHOWN_LEGS and size > _MOST_VIEW_BYTES:
            break
        i, j = residuals.legs[leg].tolist()
        jpegs, cameras = pictures[first[leg]].jpegs, extraction.rig.cameras.names
        overlays = tuple(
            _overlay(camera_words(name), jpegs.get(name, b""), view, residuals.predicted_px[k, leg])
            for k, (name, view) in enumerate(zip(cameras, observations[i].views, strict=True))
            if view.pictures
        )
        title = f"Leg {names[i]}–{names[j]}: {residuals.leg_reprojection_px[leg]:.2f} px"
        views.append(LegView(i, title, overlays))
        size += sum(len(each.jpeg) + _MARK_BYTES * len(each.marks) for each in overlays)
    return views


def thumbnails(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot]) -> list[Thumbnail]:
    """The small images of the stations, with the reasons of those that are not used."""
    used = {(o.log, o.station): i for i, o in enumerate(extraction.observations)}
    outliers = {
        i for each in solution.outliers if each.kind in ("station", "corners") for i in each.observations
    }
    rejected = {(r.log, r.station): r.reason for r in extraction.rejections}
    shown = []
    for each in snapshots:
        place = (each.log, each.station)
        i, reason = used.get(place, -1), rejected.get(place, "")
        if each.thumbnail and (i >= 0 or reason):
            name = extraction.station_name(each.log, each.station)
            jpeg = base64.b64encode(each.thumbnail).decode("ascii")
            shown.append(Thumbnail(i, name, jpeg, reason if i < 0 else "outlier" if i in outliers else ""))
    return shown


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
