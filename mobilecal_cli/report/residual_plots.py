"""Plots of residuals, correlations and the error budget, each an <svg> element, "" where there is nothing to show."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.model import NINE, SIDES, Extraction, FloatArray, Side, Solution
from mobilecal_cli.report.drawn import plot
from mobilecal_cli.report.numbers import predicted_point_rms_m, station_names
from mobilecal_cli.report.plots import image_axes
from mobilecal_cli.report.svg import WIDE, Axes, Canvas, Limits
from mobilecal_cli.report.use import FIGURES, families

_MOST_DOTS = 4000  # corners in one scatter
_LEAST_SPAN_SHARE = 0.01  # of an axis of square sizes, so that noise does not look like a difference
# Error budget: dark shades for measurements, light ones for what the robot description states.
_FAMILY_CLASSES = {
    "corners": "blue dark",
    "joint readings": "orange dark",
    "floor": "green dark",
    "wheels": "red dark",
    "encoder steps": "ink half",
    "time stamps": "ink light",
    "camera_info": "blue light",
    "head geometry": "orange light",
    "board": "green light",
    "nominal values": "red light",
    "other": "faint half",
}
_BUDGET_LABELS = {
    "camera_m": "camera position",
    "camera_rad": "camera rotation",
    "along_m_per_m": "distance per meter",
    "heading_rad_per_m": "heading per meter",
    "heading_rad_per_turn": "heading per turn",
}
_LEAST_SHARE, _LABELED_SHARE = 0.005, 0.08
_OUTLIERS = {"corners": "corners", "station": "station", "slip": "leg (slip)", "joint": "joint reading"}


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
        y = Limits.of([*values, whole, depth_mm if unit == "mm" else 0.0], zero=True)
        axes = Axes.of(canvas, Limits(-0.6, len(legs) - 0.4), y, title, (0.0, top, WIDE, top + 210.0))
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
    entries = [("line blue", "legs"), ("line green", "stereo pair alone")]
    entries += [("line red", f"outlier: {_OUTLIERS[kind]}") for kind in sorted({o.kind for o in outliers})]
    if rejected:
        entries.append(("line ink", "rejected image or station"))
    canvas = Canvas(WIDE, 290.0, "residuals over time, with outliers and rejected stations")
    top = canvas.legend(entries, 8.0, 16.0)
    x = Limits.of([(t - start) * 1e-9 for t in times])
    axes = Axes.of(canvas, x, Limits.of(values, zero=True), "residual [px]", (0.0, top + 8.0, WIDE, 290.0))
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
    "The stereo pair alone, without robot motion. Good: residuals of about 0.3 px or less, and the same "
    "square size at all distances. High residuals at all stations: camera_info does not match the cameras. "
    "Square size different from the stated one: the baseline or the stated size is wrong.",
)
def station_residuals(_: Solution, extraction: Extraction) -> str:
    """Residual of the flat board in the stereo pair, and the measured square size, at each station."""
    seen, names = extraction.observations, station_names(extraction)
    square_mm = [o.square_m * 1e3 for o in seen]
    stated = [] if extraction.board.square_m is None else [extraction.board.square_m * 1e3]
    x = Limits(-0.6, len(seen) - 0.4)
    canvas = Canvas(WIDE, 420.0, "stereo residual and square size at each station")
    stereo = Limits.of([o.reprojection_px for o in seen], zero=True)
    axes = Axes.of(canvas, x, stereo, "stereo residual of the flat board [px]", (0.0, 0.0, WIDE, 200.0))
    axes.grid(x=False)
    for i, o in enumerate(seen):
        axes.bar(i, o.reprojection_px, "green", [i], f"station {names[i]}: {o.reprojection_px:.3f} px")
    axes.names(names, "")
    size = Limits.of([*square_mm, *stated], margin=0.3, least=_LEAST_SPAN_SHARE * square_mm[0])
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
    each="side",
)
def picture_residuals(_: Solution, extraction: Extraction, side: Side) -> str:
    """Residuals of the corners from the fitted flat board over the image, one line per corner, magnified.

    The board's pose at each station comes from the stereo pair, so the robot's motion has no influence.
    """
    found = [_board_residuals(extraction, side, i) for i in range(len(extraction.observations))]
    lengths = np.concatenate([np.linalg.norm(r, axis=1) for _, r in found])
    if not len(lengths):
        return ""
    canvas, axes = image_axes(extraction, side, f"corner residuals across the image of the {side} camera")
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
)
def residual_histogram(_: Solution, extraction: Extraction) -> str:
    """How often the corners are off by how much from the fitted flat board, u and v of both cameras."""
    stations = range(len(extraction.observations))
    values = np.concatenate([_board_residuals(extraction, side, i)[1] for side in SIDES for i in stations])
    most = float(np.percentile(np.abs(values), 99.5)) or 1.0
    counts, edges = np.histogram(values, bins=41, range=(-most, most))
    share = 100 * counts / values.size
    canvas = Canvas(WIDE, 200.0, "histogram of the corner residuals")
    axes = Axes.of(
        canvas, Limits(-most, most), Limits.of(share, zero=True), "corner residuals, share of all [%]"
    )
    axes.grid("residual of a coordinate [px]")
    left, right = edges[:-1], edges[1:]
    steps = np.stack([left, share, right, share], axis=1).reshape(-1, 2)
    axes.line(np.concatenate([[[left[0], 0.0]], steps, [[right[-1], 0.0]]]), "blue")
    return canvas.svg


def _board_residuals(extraction: Extraction, side: Side, i: int) -> tuple[FloatArray, FloatArray]:
    """Detected corners of a station, (n, 2), and their residuals from the fitted board, (n, 2), px."""
    cameras, o = extraction.rig.cameras, extraction.observations[i]
    camera, T = (cameras.left, np.eye(4)) if side == "left" else (cameras.right, se3.inverse(cameras.T_c_r))
    corners = o.left if side == "left" else o.right
    points = se3.act(T @ o.T_c_k, extraction.board.grid() * o.square_m)
    return corners.pixels[corners.seen], (corners.pixels - project(camera, points))[corners.seen]


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
    labels = [*NINE, *(_BUDGET_LABELS[figure.field] for figure in at_work)]
    used = [k for k in range(len(names)) if shares[k, columns].max() > _LEAST_SHARE]
    canvas = Canvas(WIDE, 60.0 + 24.0 * len(labels), "error budget: what each variance consists of")
    left, wide = 122.0, WIDE - 132.0
    canvas.legend([(f"fill {_FAMILY_CLASSES[names[k]]}", names[k]) for k in used], 8.0, 14.0)
    for row, (label, column) in enumerate(zip(labels, columns, strict=True)):
        y, x = 46.0 + 24.0 * row, left
        canvas.text(left - 8, y + 13, label, anchor="end")
        for k in used:
            width = wide * float(shares[k, column])
            if width <= 0:
                continue
            share, kind = f"{100 * shares[k, column]:.0f} %", f"fill {_FAMILY_CLASSES[names[k]]}"
            canvas.shape("rect", kind, (), f"{label}: {names[k]} {share}", x=x, y=y, width=width, height=18)
            if shares[k, column] > _LABELED_SHARE:
                canvas.text(x + width / 2, y + 13, share, anchor="middle")
            x += width
    return canvas.svg
