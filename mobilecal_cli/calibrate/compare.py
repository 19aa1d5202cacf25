"""`mobilecal compare`: compare params.yaml files of one robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mobilecal_cli.calibrate.load import read_params
from mobilecal_cli.comparison import Difference, difference, history
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.outputs import check_file, write_file
from mobilecal_cli.model import NINE
from mobilecal_cli.report.comparison import Comparison, history_plot

#: Change of an unobservable parameter, in standard deviations of its nominal value, that no nominal value explains.
MOST_NOMINAL_SIGMAS = 5.0


def broken_limits(
    change: Difference,
    max_sigma: float | None = None,
    max_ray_mm: float | None = None,
    max_heading_deg: float | None = None,
) -> list[str]:
    """The limits that a difference exceeds, as text; the one of unobservable parameters always applies.

    Args:
        max_sigma: limit of any parameter, in standard deviations; None for none.
        max_ray_mm: limit of the shift of a point 2 m ahead of the camera, mm.
        max_heading_deg: limit of the change of heading per full turn, deg.
    """
    broken = [
        f"{NINE[k]}, unobservable or fixed in one calibration, by {change.nominal_sigmas[k]:.1f} sigma "
        f"(limit {MOST_NOMINAL_SIGMAS:g})"
        for k in np.flatnonzero(change.nominal_sigmas > MOST_NOMINAL_SIGMAS)
    ]
    if max_sigma is not None:
        if not change.known.any():
            broken.append("no standard deviations for the limit in sigma")
        blind = np.flatnonzero(change.unobservable)
        broken += [f"no conclusion about {NINE[k]}: unobservable or fixed" for k in blind]
        sigmas = np.nan_to_num(np.abs(change.sigmas))
        worst = int(np.argmax(sigmas))
        if sigmas[worst] > max_sigma:
            broken.append(f"{NINE[worst]} by {sigmas[worst]:.1f} sigma (limit {max_sigma:g})")
    if max_ray_mm is not None and change.ray_m * 1e3 > max_ray_mm:
        broken.append(f"point 2 m ahead by {change.ray_m * 1e3:.2f} mm (limit {max_ray_mm:g})")
    turn_deg = abs(math.degrees(change.heading_rad_per_turn))
    if max_heading_deg is not None and turn_deg > max_heading_deg:
        broken.append(f"heading per full turn by {turn_deg:.3f} deg (limit {max_heading_deg:g})")
    return broken


def compare(
    files: Sequence[Path], *, plot: Path | None = None, force: bool = False, **limits: float | None
) -> Comparison:
    """Compare calibrations with the first one.

    Args:
        files: params.yaml files, two or more.
        limits: see `broken_limits`.
        plot: SVG file to write: every parameter over all calibrations.
        force: replace an existing plot.

    Raises:
        ConfigError: a file cannot be read, there is only one, or their frames differ.
        OutputError: the plot cannot be written.
    """
    if len(files) < 2:
        raise ConfigError("only one calibration to compare", "give two or more params.yaml files")
    if plot is not None:
        check_file(plot, force, files)
    robots = tuple(read_params(path) for path in files)
    names = tuple(str(path) for path in files)
    differences = tuple(difference(robots[0], robot) for robot in robots[1:])
    past = history(robots)
    if plot is not None:
        labels = [robot.created or name for robot, name in zip(robots, names, strict=True)]
        write_file(plot, history_plot(labels, past).encode(), force)
    broken = tuple(
        f"{name}: {what}"
        for name, change in zip(names[1:], differences, strict=True)
        for what in broken_limits(change, **limits)
    )
    return Comparison(names, robots, differences, past if len(files) > 2 else None, broken)
