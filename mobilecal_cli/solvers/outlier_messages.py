"""Descriptions of outliers, with their times in the recording."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli.likelihood.state import board_in_camera
from mobilecal_cli.model import Extraction, Outlier
from mobilecal_cli.se3 import inverse, log
from mobilecal_cli.solvers.fit import Fit


def outliers_of(extraction: Extraction, fit: Fit) -> tuple[Outlier, ...]:
    """Description of each outlier of a fit, in order of time."""
    seen, inliers, state = extraction.observations, fit.inliers, fit.lin.state
    several = len(extraction.wheels) > 1
    begin = {number: int(track.time_ns[0]) for number, track in enumerate(extraction.wheels)}

    def name(i: int) -> str:
        return f"{seen[i].log}:{seen[i].station}" if several else str(seen[i].station)

    def clock(i: int) -> str:
        return f"{(seen[i].time_ns - begin[seen[i].log]) / 1e9:.1f} s"

    found: list[Outlier] = []
    legs = fit.lin.legs.residual[:, :3]
    for leg in np.flatnonzero(~inliers.legs):
        i, j = (int(k) for k in fit.data.legs[leg])
        x, y, psi = legs[leg]
        by = f"{math.hypot(x, y) * 1e3:.0f} mm and {abs(math.degrees(psi)):.1f} degrees"
        text = (
            f"Wheel slip or moved board between stations {name(i)} and {name(j)}, {clock(j)}: wheels and cameras "
            f"differ by {by}. The odometry of this leg is excluded."
        )
        found.append(Outlier("slip", seen[i].log, (i, j), seen[j].time_ns, text))
    expected = board_in_camera(fit.data, state)
    for i in (int(k) for k in np.flatnonzero(~inliers.views)):
        off = log(seen[i].T_c_k @ inverse(expected[i]))
        shift = (seen[i].T_c_k[:3, 3] - expected[i][:3, 3]) * 1e3
        text = (
            f"Station {name(i)}, {clock(i)}: the board is {np.linalg.norm(shift):.0f} mm and "
            f"{math.degrees(float(np.linalg.norm(off[:3]))):.1f} degrees from the pose that the other stations "
            "predict. Its images are excluded. Check for a moved or wrong board, or wrong joint readings."
        )
        found.append(Outlier("station", seen[i].log, (i,), seen[i].time_ns, text))
    excluded = fit.data.seen & ~inliers.corners
    joints, prismatic = extraction.rig.chain.joints, extraction.rig.chain.prismatic
    for i, j in ((int(a), int(b)) for a, b in np.argwhere(~inliers.readings)):
        error = -state.joint_errors[i, j]
        by = f"{error * 1e3:+.1f} mm" if joints[j] in prismatic else f"{math.degrees(error):+.2f} degrees"
        text = f"Station {name(i)}, {clock(i)}: the reading of joint {joints[j]} is wrong by {by}. It is excluded."
        found.append(Outlier("joint", seen[i].log, (i,), seen[i].time_ns, text))
    for i in (int(k) for k in np.flatnonzero(excluded.any(axis=(1, 2)) & inliers.views)):
        left, right = (int(n) for n in excluded[i].sum(axis=1))
        counts = f"{left} corners of the left image and {right} of the right image"
        text = f"Station {name(i)}, {clock(i)}: {counts} do not fit the board and are excluded."
        found.append(Outlier("corners", seen[i].log, (i,), seen[i].time_ns, text))
    return tuple(sorted(found, key=lambda o: (o.log, o.time_ns)))
