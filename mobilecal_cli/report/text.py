"""The short summary for a terminal: plain lines, nothing from the log can steer the terminal."""

from __future__ import annotations

import textwrap

from mobilecal_cli import se3
from mobilecal_cli.model import Evaluation, Extraction, Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.evaluation import evaluation_text
from mobilecal_cli.report.numbers import (
    NEAR_LOCK_DEG,
    nine_numbers,
    reference_frame,
    reference_pose,
    sigmas,
    stations_looked_at,
    written,
)
from mobilecal_cli.report.verdict import Verdict

_WIDTH = 96


def summary_table(
    solution: Solution, extraction: Extraction, verdict: Verdict, trial: Evaluation | None = None
) -> str:
    """The nine numbers with units, the quality and the verdict, as lines of text."""
    rig = extraction.rig
    ax, ay, az, tx, ty, tz, right, left, separation = nine_numbers(solution.parameters, rig.cameras)
    margin_deg = se3.gimbal_margin_deg(reference_pose(solution.parameters, rig.cameras)[:3, :3])
    lines = [
        f"Camera {visible(reference_frame(rig.cameras))} on the head {visible(rig.chain.head_frame)}",
        _row("rotation x, y, z", (f"{ax:.3f}", f"{ay:.3f}", f"{az:.3f}"), "deg"),
        _row("translation x, y, z", (f"{tx:.2f}", f"{ty:.2f}", f"{tz:.2f}"), "mm"),
    ]
    if margin_deg < NEAR_LOCK_DEG:
        lines.append(f"  (y is {margin_deg:.1f} deg from gimbal lock: use the quaternion in params.yaml)")
    used, looked = len(extraction.observations), stations_looked_at(extraction)
    lines += [
        "Wheels",
        _row("radius right, left", (f"{right:.2f}", f"{left:.2f}", ""), "mm"),
        _row("separation", (f"{separation:.2f}", "", ""), "mm"),
        "Quality",
        _row("stations used, looked at", (str(used), str(looked), ""), ""),
        _row("point error, linear's", _pair(solution.point_rms_m, solution.linear.point_rms_m), "mm"),
        _row("reprojection error", (f"{solution.reprojection_rms_px:.2f}", "", ""), "px"),
    ]
    known = [written(sigma) for sigma in sigmas(solution, rig.cameras)]
    if known:
        lines += [
            "One standard deviation",
            _row("rotation about x, y, z", (known[0], known[1], known[2]), "deg"),
            _row("translation x, y, z", (known[3], known[4], known[5]), "mm"),
            _row("radii, separation", (known[6], known[7], known[8]), "mm"),
        ]
    if trial is not None:
        lines += ["Tried on the stations that were held out", evaluation_text(trial, ()).rstrip("\n")]
    for outlier in solution.outliers:
        lines += textwrap.wrap(f"Left out: {visible(outlier.text)}", _WIDTH, subsequent_indent="  ")
    head = f"{verdict.level}: {verdict.reason}"
    lines += ["", *textwrap.wrap(head, _WIDTH), *textwrap.wrap(f"Next: {verdict.next_step}", _WIDTH)]
    return "\n".join(lines) + "\n"


def _pair(first_m: float, second_m: float) -> tuple[str, str, str]:
    return f"{first_m * 1e3:.2f}", f"{second_m * 1e3:.2f}", ""


def _row(name: str, values: tuple[str, str, str], unit: str) -> str:
    numbers = "".join(f"{value:>11}" for value in values)
    return f"  {name:<26}{numbers}  {unit}".rstrip()
