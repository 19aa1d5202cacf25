"""The summary for the terminal, as plain text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator

from mobilecal_cli.model import NINE, Evaluation, Extraction, FloatArray, Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.contradictions import contradiction_sentences
from mobilecal_cli.report.evaluation import evaluation_text
from mobilecal_cli.report.numbers import (
    NEAR_LOCK_DEG,
    decimals_of,
    nine_numbers,
    reference_frame,
    reference_std,
    rotation_of,
    stations_looked_at,
    std_text,
)
from mobilecal_cli.report.outliers import outlier_sentences

_WIDTH = 80
_LENGTHS = ("Translation x", "Translation y", "Translation z", "Radius, right", "Radius, left", "Separation")
_CLOCKS = (("time_joints", "Cameras to joints"), ("time_wheels", "Cameras to wheels"))


def summary_table(solution: Solution, extraction: Extraction, trial: Evaluation | None = None) -> str:
    """The nine parameters with their standard deviations, the clock offsets and the quality, as lines of text.

    Names from the recording are escaped, so that they cannot control the terminal.
    """
    cameras = solution.cameras
    numbers = nine_numbers(solution.parameters, cameras)
    known = solution.uncertainty
    std_m = reference_std(solution)[3:] or (math.nan,) * 6
    seen = [True] * 6 if known is None else (known.observable | known.fixed)[3:].tolist()
    lengths = [
        _row(name, value, None if s is None else 1e3 * s, "mm" if ok else "mm, unobservable", 2)
        for name, value, s, ok in zip(_LENGTHS, numbers[3:], std_m, seen, strict=True)
    ]
    frames = f"{visible(reference_frame(cameras))} in {visible(extraction.rig.chain.head_frame)}"
    lines = [
        f"Camera: {frames}" + (" (± 1 sigma)" if known is not None else ""),
        *_rotation(solution, extraction),
        *lengths[:3],
        "Wheels",
        *lengths[3:],
    ]
    clocks = [
        (name, solution.constants[key].value, solution.constants[key].std)
        for key, name in _CLOCKS
        if key in solution.constants
    ]
    if clocks:
        lines.append("Clock offsets, to be added to the image time stamps")
        lines += [_row(name, 1e3 * value, 1e3 * s or None, "ms", 3) for name, value, s in clocks]
    refined, linear = (f"{1e3 * error:.2f}" for error in (solution.point_rms_m, solution.linear.point_rms_m))
    lines += [
        "Quality",
        _line("Stations used", str(len(extraction.observations)), f"of {stations_looked_at(extraction)}"),
        _line("Point error: refined / linear", refined, f"/ {linear} mm"),
        _line("Reprojection error", f"{solution.reprojection_rms_px:.2f}", "px"),
    ]
    if trial is not None:
        lines += ["Test on the held-out stations", evaluation_text(trial, ()).rstrip("\n")]
    for found in solution.contradictions:
        what, cure = contradiction_sentences(found, solution)
        lines += textwrap.wrap(f"Robot description: {what} {cure}", _WIDTH, subsequent_indent="  ")
    for sentence in outlier_sentences(solution.outliers, extraction):
        lines += textwrap.wrap(f"Outlier: {visible(sentence)}", _WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def _rotation(solution: Solution, extraction: Extraction) -> Iterator[str]:
    """Rotation vector and quaternion; away from gimbal lock also the Euler angles."""
    found, known = rotation_of(solution), solution.uncertainty
    yield from _angles("Rotation vector {}", found.vector_deg, found.vector_std_deg)
    if known is not None and found.vector_std_deg is None:
        fixed = [name for name, ok in zip(NINE[:3], ~known.fixed[:3], strict=True) if not ok]
        yield f"    ({', '.join(fixed)} fixed: for the other standard deviations see the report)"
    yield f"  {'Quaternion x, y, z, w':<26}" + "".join(f"{q:>11.6f}" for q in found.quaternion_xyzw)
    if found.euler_deg is None:
        yield f"    ({found.lock_deg:.1f} deg from gimbal lock, limit {NEAR_LOCK_DEG:g}: no Euler angles)"
    else:
        yield from _angles("Euler angle {} (ZYX)", found.euler_deg, found.euler_std_deg)


def _angles(name: str, values: FloatArray, std: FloatArray | None) -> Iterator[str]:
    for axis, value, s in zip("xyz", values, (math.nan,) * 3 if std is None else std, strict=True):
        yield _row(name.format(axis), value, s, "deg", 3)


def _row(name: str, value: float, std: float | None, unit: str, decimals: int) -> str:
    """One parameter; a standard deviation of None means that it is fixed, NaN that none is known."""
    if std is None:
        return _line(name, f"{value:.{decimals}f}", f"{unit}, fixed")
    if not math.isfinite(std):
        return _line(name, f"{value:.{decimals}f}", unit)
    return _line(name, f"{value:.{decimals_of(std, decimals)}f}", f"± {std_text(std)} {unit}")


def _line(name: str, value: str, rest: str) -> str:
    return f"  {name:<30}{value:>12} {rest}".rstrip()
