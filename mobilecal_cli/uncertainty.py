"""What a log's motion cannot show, in words, before anything is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.errors import ObservationError, SolveError
from mobilecal_cli.kinematics import cut_at, head_pose
from mobilecal_cli.model import Extraction, FloatArray, HeadChain, IntArray, WheelTrack

FEWEST_STATIONS = 4  # three legs give nine equations in translation and nine in rotation for nine unknowns
_TILTED_RAD = np.radians(3.0)  # a smaller range leaves Tsai-Lenz with parallel axes, whatever the noise
_TURNED_RAD = 0.1  # wheel rotation: with usual wheels about 2.5 degrees of heading
_DRIVEN_RAD = 0.1  # wheel rotation: with usual wheels about 2 cm


@dataclass(frozen=True, slots=True)
class Gap:
    """Something that the motion does not show.

    Attributes:
        parameters: what stays unknown.
        because: what the motion was, with its numbers.
        cure: the motion that would show it.
    """

    parameters: tuple[str, ...]
    because: str
    cure: str


def _vertical_range_rad(R_v_h: FloatArray) -> float:
    """Largest angle between the verticals that the head saw, in its own frame: (N, 3, 3) → rad."""
    vertical_h = R_v_h[:, 2, :]
    return float(np.arccos(np.clip(vertical_h @ vertical_h.T, -1, 1)).max())


def motion_gaps(extraction: Extraction) -> tuple[Gap, ...]:
    """The cases of motion in which some of the nine numbers are not observable (`method.md`, last table)."""
    observations = extraction.observations
    times = [
        np.array([o.time_ns for o in observations if o.log == log]) for log in range(len(extraction.wheels))
    ]
    return gaps_between(
        extraction.rig.chain, np.stack([o.joints for o in observations]), extraction.wheels, times
    )


def gaps_between(
    chain: HeadChain, joints: FloatArray, wheels: Sequence[WheelTrack], times_ns: Sequence[IntArray]
) -> tuple[Gap, ...]:
    """`motion_gaps` of stations, whatever was seen there.

    Args:
        chain: base to head.
        joints: (N, J) head joint readings at the stations of all logs, rad or m.
        wheels: both wheels of each log.
        times_ns: (n,) stations' times in each log, increasing.
    """
    gaps = []
    T_v_h = head_pose(chain, joints)
    tilted = _vertical_range_rad(T_v_h[:, :3, :3])
    if tilted < _TILTED_RAD:
        gaps.append(
            Gap(
                ("t along the vertical", "rotation about it"),
                f"the head's tilt spans only {np.degrees(tilted):.2f} degrees",
                "tilt the head up and down by 15 degrees or more between stations, and pan it",
            )
        )
    Phi = [np.zeros((0, 2))]
    for track, times in zip(wheels, times_ns, strict=True):
        if len(times) > 1:
            Phi.append(cut_at(track, times).totals_rad)
    right, left = np.concatenate(Phi).T
    turned, driven = np.abs(right - left).max(initial=0), np.abs(right + left).max(initial=0) / 2
    if turned < _TURNED_RAD and driven < _DRIVEN_RAD:
        gaps.append(
            Gap(
                ("radius_right", "radius_left", "separation"),
                f"the wheels turn by at most {np.degrees(max(turned, driven)):.1f} degrees between stations: "
                "the base stands still",
                "drive and turn the base between stations",
            )
        )
    elif turned < _TURNED_RAD:
        gaps.append(
            Gap(
                ("separation", "ratio of the radii"),
                f"the base only drives straight: the two wheels' rotations differ by at most "
                f"{np.degrees(turned):.1f} degrees between stations",
                "turn the base by 20 degrees or more between some stations",
            )
        )
    elif driven < _DRIVEN_RAD:
        gaps.append(
            Gap(
                ("common scale of radius_right, radius_left, separation",),
                f"the base only turns on the spot: the wheels' mean rotation is at most "
                f"{np.degrees(driven):.1f} degrees between stations",
                "drive forward or back by 20 cm or more between some stations",
            )
        )
    return tuple(gaps)


def require_stations(extraction: Extraction) -> None:
    """Refuse an extraction of too few stations.

    Raises:
        ObservationError: fewer than four stations; says how many, and counts the rejections by reason.
    """
    have = len(extraction.observations)
    if have < FEWEST_STATIONS:
        reasons: dict[str, int] = {}
        for rejection in extraction.rejections:
            reasons[rejection.reason] = reasons.get(rejection.reason, 0) + 1
        counted = ", ".join(f"{n} x {reason}" for reason, n in sorted(reasons.items(), key=lambda r: -r[1]))
        raise ObservationError(
            f"the board was found at {have} of {extraction.counts.get('stations', have)} stations, "
            f"{FEWEST_STATIONS} are needed" + (f"; left out: {counted}" if counted else ""),
            "keep the whole board in both pictures, at rest, in good light, with squares of 7 pixels or more",
        )


def require_observable(extraction: Extraction) -> None:
    """Refuse an extraction that cannot show all nine numbers: for methods that hold nothing at nominal values.

    Raises:
        SolveError: naming the parameters and the motion that would show them.
    """
    gaps = motion_gaps(extraction)
    if gaps:
        raise SolveError(
            "; ".join(f"not observable: {', '.join(g.parameters)}: {g.because}" for g in gaps),
            "; ".join(g.cure for g in gaps),
        )
