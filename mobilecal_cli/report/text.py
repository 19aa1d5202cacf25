"""The summary for the terminal, as plain text."""

from __future__ import annotations

from collections.abc import Iterator

from mobilecal_cli.model import NINE, FloatArray
from mobilecal_cli.model.text import visible, wrapped
from mobilecal_cli.report.evaluation import evaluation_text
from mobilecal_cli.report.numbers import NEAR_LOCK_DEG, PARAMETERS, decimals_of, std_text
from mobilecal_cli.report.values import OdometryData, ReportData

_WIDTH = 80


def summary_text(report: ReportData) -> str:
    """The nine parameters with their standard deviations, the clock offsets and the quality, as lines of text.

    Names from the recording are escaped, so that they cannot control the terminal.
    """
    found, quality, known = report.parameters, report.quality, report.uncertainty
    lengths, odometry = list(_lengths(report)), report.parameters.odometry
    frames = f"{visible(found.child_frame)} in {visible(found.parent_frame)}"
    lines = [
        f"Camera: {frames}" + (" (± 1 sigma)" if known is not None else ""),
        *_rotation(report),
        *lengths[:3],
        "Wheels" if odometry is None else f"Odometry on {visible(odometry.topic)} (factors)",
        *(lengths[3:] if odometry is None else _factors(report, odometry)),
    ]
    keys = {"time_joints": "Cameras to joints", "time_wheels": "Cameras to wheels"}
    clocks = [(name, report.constants[key]) for key, name in keys.items() if key in report.constants]
    if clocks:
        lines.append("Clock offsets, to be added to the image time stamps")
        lines += [_row(name, 1e3 * c.value, 1e3 * c.std if c.std else None, "ms", 3) for name, c in clocks]
    lines += [
        "Quality",
        _line("Stations used", str(quality.stations), f"of {quality.stations_found}"),
        _line(
            "Point error: refined / linear",
            f"{quality.point_rms_mm:.2f}",
            f"/ {report.linear.point_rms_mm:.2f} mm",
        ),
    ]
    if quality.reprojection_rms_px:
        lines.append(_line("Reprojection error", f"{quality.reprojection_rms_px:.2f}", "px"))
    if report.hold_out is not None:
        lines += ["Test on the held-out stations", evaluation_text(report.hold_out).rstrip("\n")]
    for each in report.contradictions:
        lines += wrapped(f"{each.text} {each.cure}", "Robot description: ", "  ", _WIDTH)
    for sentence in report.outliers_text:
        lines += wrapped(sentence, "Outlier: ", "  ", _WIDTH)
    return "\n".join(lines) + "\n"


def _lengths(report: ReportData) -> Iterator[str]:
    """Translation and wheels."""
    p, known = report.parameters, report.uncertainty
    values = (
        p.translation_x_mm, p.translation_y_mm, p.translation_z_mm, p.radius_right_mm, p.radius_left_mm, p.separation_mm
    )  # fmt: skip
    for parameter, value in zip(PARAMETERS[3:], values, strict=True):
        if value is None:
            continue
        name, label = parameter.name, parameter.label.capitalize()
        if known is None:
            yield _line(label, f"{value:.2f}", "mm")
            continue
        std = known.std[name] * parameter.factor or None
        unit = "mm" if known.observable[name] or known.fixed[name] else "mm, unobservable"
        unit = "mm, from the robot description" if known.described[name] else unit
        yield _row(label, value, std, unit, 2)


def _factors(report: ReportData, odometry: OdometryData) -> Iterator[str]:
    """Factors of odometry, as controllers take them."""
    known = report.uncertainty
    hidden = known is not None and not all(known.observable[name] or known.fixed[name] for name in NINE[6:])
    for name, factor in odometry.factors.items():
        label = name.replace("_", " ").capitalize()
        if factor.std is None:
            yield _line(label, f"{factor.value:.5f}", "")
        else:
            yield _row(label, factor.value, factor.std or None, "(unobservable)" if hidden else "", 5)


def _rotation(report: ReportData) -> Iterator[str]:
    """Rotation vector and quaternion; away from gimbal lock also the Euler angles."""
    found, known = report.parameters, report.uncertainty
    yield from _angles("Rotation vector {}", found.rotation_vector_deg, found.rotation_vector_std_deg)
    if known is not None and found.rotation_vector_std_deg is None:
        fixed = [parameter.name for parameter in PARAMETERS[:3] if known.fixed[parameter.name]]
        yield f"    ({', '.join(fixed)} fixed: for the other standard deviations see the report)"
    yield f"  {'Quaternion x, y, z, w':<26}" + "".join(f"{q:>11.6f}" for q in found.quaternion_xyzw)
    if found.euler_zyx_deg is None:
        yield f"    ({found.gimbal_margin_deg:.1f} deg from gimbal lock, limit {NEAR_LOCK_DEG:g}: no Euler angles)"
    else:
        yield from _angles("Euler angle {} (ZYX)", found.euler_zyx_deg, found.euler_zyx_std_deg)


def _angles(name: str, values: FloatArray, stds: FloatArray | None) -> Iterator[str]:
    for k, (axis, value) in enumerate(zip("xyz", values, strict=True)):
        label = name.format(axis)
        yield _line(label, f"{value:.3f}", "deg") if stds is None else _row(label, value, stds[k], "deg", 3)


def _row(name: str, value: float, std: float | None, unit: str, decimals: int) -> str:
    """One parameter; a standard deviation of None means that it is fixed."""
    if std is None:
        return _line(name, f"{value:.{decimals}f}", f"{unit}, fixed" if unit else "fixed")
    return _line(name, f"{value:.{decimals_of(std, decimals)}f}", f"± {std_text(std)} {unit}".rstrip())


def _line(name: str, value: str, rest: str) -> str:
    return f"  {name:<30}{value:>12} {rest}".rstrip()
