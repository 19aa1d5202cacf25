"""Parameters that a recording's motion leaves unobservable, described before any solve."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ObservationError, SolveError
from mobilecal_cli.kinematics import (
    DRIVEN_RAD,
    FEWEST_LEGS,
    TILTED_RAD,
    TURNED_RAD,
    cut_at,
    encoder_steps_rad,
    head_pose,
    motion_seen,
    unseen_height,
)
from mobilecal_cli.model import NINE, Extraction, FloatArray, HeadChain, IntArray, WheelTrack
from mobilecal_cli.stations import NO_READINGS
from mobilecal_cli.vision import AMBIGUOUS, OTHER_BOARDS, SECOND_BOARD, SQUARES_UNKNOWN, readable_words

FEWEST_STATIONS = FEWEST_LEGS + 1  # in one recording
_HEAD_M = 0.5  # that the motion of a head alone moves a camera, at most


@dataclass(frozen=True, slots=True)
class Gap:
    """Parameters that the motion leaves unobservable.

    Attributes:
        parameters: the unobservable parameters.
        because: the reason, with the amount of motion.
        cure: the motion that makes them observable.
        closed_by: sets of parameters of `NINE`; if all of one set are fixed, no such motion is needed.
    """

    parameters: tuple[str, ...]
    because: str
    cure: str
    closed_by: tuple[tuple[str, ...], ...]


def motion_gaps(extraction: Extraction, fixed: Collection[str] = ()) -> tuple[Gap, ...]:
    """Gaps in the motion that leave some of the nine parameters unobservable, except `fixed` ones (`method.md`)."""
    observations = extraction.observations
    times = [
        np.array([o.time_ns for o in observations if o.log == log]) for log in range(len(extraction.wheels))
    ]
    joints, logs = np.stack([o.joints for o in observations]), np.array([o.log for o in observations])
    camera_k = se3.inverse(np.stack([o.T_c_k for o in observations]))[:, :3, 3]
    seen_m = max(float(np.linalg.norm(np.ptp(camera_k[logs == log], axis=0))) for log in set(logs.tolist()))
    gaps = gaps_between(extraction.rig.chain, joints, extraction.wheels, times, seen_m)
    return tuple(gap for gap in gaps if not any(set(fixed).issuperset(s) for s in gap.closed_by))


def gaps_between(
    chain: HeadChain,
    joints: FloatArray,
    wheels: Sequence[WheelTrack],
    times_ns: Sequence[IntArray],
    seen_m: float = 0.0,
) -> tuple[Gap, ...]:
    """Gaps in the motion between stations, from joints and wheels alone; see `motion_gaps`.

    Args:
        chain: base to head.
        joints: (N, J) head joint readings at the stations of all recordings, rad or m.
        wheels: both wheels of each recording.
        times_ns: (n,) stations' times in each recording, increasing.
        seen_m: largest extent of the camera's places as the images show them.
    """
    Phi = [np.zeros((0, 2))]
    for track, times in zip(wheels, times_ns, strict=True):
        if len(times) > 1:
            Phi.append(cut_at(track, times).totals_rad)
    motion = motion_seen(head_pose(chain, joints), np.concatenate(Phi), encoder_steps_rad(wheels))
    gaps = []
    if not motion.tilts and unseen_height(chain) is None:
        gaps.append(
            Gap(
                ("translation along the vertical", "rotation about the vertical"),
                f"the head's tilt spans only {np.degrees(motion.tilted_rad):.2f} degrees "
                f"(at least {np.degrees(TILTED_RAD):.0f} needed)",
                "tilt the head up and down by 15 degrees or more between stations, and pan it",
                (NINE[3:6],),
            )
        )
    if motion.shows_wheels:
        return tuple(gaps)
    turned, driven = motion.turned_rad, motion.driven_rad
    if not (motion.turns or motion.drives):
        rotate = (
            f"the wheels rotate by at most {np.degrees(max(turned, driven)):.1f} degrees "
            f"between stations (at least {np.degrees(DRIVEN_RAD):.1f} needed)"
        )
        because, cure = f"the base stands still: {rotate}", "drive and turn the base between stations"
        if seen_m > _HEAD_M:
            because = f"the images show a drive of {seen_m:.1f} m, but {rotate}"
            cure = "check the unit and ticks_per_revolution of the wheel readings, and that these are of this drive"
        gaps.append(Gap(NINE[6:], because, cure, (NINE[6:],)))
    elif not motion.turns:
        because = (
            f"the base only drives straight: the rotations of the two wheels differ by at most "
            f"{np.degrees(turned):.1f} degrees between stations (at least {np.degrees(TURNED_RAD):.1f} needed)"
        )
        cure = "turn the base by 20 degrees or more between some stations"
        if not turned:
            because = "the left and the right wheel have identical readings between all stations"
            cure = f"check that the driver publishes both wheels, or {cure}"
        gaps.append(Gap(("separation", "ratio of the radii"), because, cure, (("separation",),)))
    else:
        scale = "common scale of radius_right, radius_left, separation"
        because = (
            f"the base only turns in place: the mean rotation of the two wheels is at most "
            f"{np.degrees(driven):.1f} degrees between stations (at least {np.degrees(DRIVEN_RAD):.1f} needed)"
        )
        cure = "drive forward or back by 20 cm or more between some stations"
        gaps.append(Gap((scale,), because, cure, tuple((name,) for name in NINE[6:])))
    return tuple(gaps)


def require_stations(extraction: Extraction) -> None:
    """Refuse an extraction with too few stations, or too few legs between consecutive stations of one recording.

    Raises:
        ObservationError: fewer than four stations or three legs; gives the numbers, and the rejections by reason.
    """
    have = len(extraction.observations)
    logs = len({o.log for o in extraction.observations})
    if have >= FEWEST_STATIONS and have - logs >= FEWEST_LEGS:
        return
    reasons = Counter((item.stage, item.reason) for item in extraction.rejections).most_common()
    counted = ", ".join(f"{n} x {reason}" for (_, reason), n in reasons)
    rejected = f"; rejected: {counted}" if counted else ""
    looked_at = extraction.counts.get("stations", have)
    where = f"the board was found at {have} of {looked_at} stations"
    images, needed = extraction.rig.cameras.images_words, readable_words(extraction.board)
    cure = (
        f"keep the whole board in {images}, at rest, in good light, with {needed}; where the robot hardly rests in "
        "front of it, use --stations all"
    )
    stage, reason = reasons[0][0] if reasons else ("", "")
    if have == looked_at or stage == "stations":
        more = "stop at more places in front of the board"
        if reason == NO_READINGS:
            more = "check that joints and wheels are recorded as long as the images, with stamps of one clock"
        cure = extraction.with_notes(more)
    ambiguous = sum(item.reason == AMBIGUOUS for item in extraction.rejections)
    if have < FEWEST_STATIONS <= have + ambiguous:
        cure = (
            "use a board of which one number of inner corners is even and the other odd, such as 9 x 6, or one with "
            "markers; or stand the board upright"
        )
    if reason in OTHER_BOARDS:
        cure = (
            f"set the number of the board's inner corners with --board: {extraction.board.columns} x "
            f"{extraction.board.rows} was used; keep other checkerboards out of view"
        )
    if reason == SECOND_BOARD:
        cure = "cover or remove the other checkerboard: only one may be in view"
    if reason == SQUARES_UNKNOWN:
        cure = "set board.square_m in rig.yaml, or with --set: stations that one camera alone shows need it"
    if extraction.measured:
        where, cure = f"poses of {have} stations", "give poses at more places in front of the target"
    if have < FEWEST_STATIONS:
        raise ObservationError(f"{where} (at least {FEWEST_STATIONS} needed){rejected}", cure)
    raise ObservationError(
        f"{where} in {logs} recordings: only {have - logs} legs join consecutive stations of one recording "
        f"(at least {FEWEST_LEGS} needed){rejected}",
        f"record more stations in each recording; {cure}",
    )


def require_observable(extraction: Extraction) -> None:
    """Refuse an extraction with unobservable parameters, for methods that do not use nominal values.

    Raises:
        SolveError: names the unobservable parameters and the missing motion.
    """
    gaps = motion_gaps(extraction)
    if unseen_height(extraction.rig.chain) is not None:
        because, cure = (
            "no joint of the head tilts the camera",
            "use --method ml, which takes it as described",
        )
        gaps = (Gap(("height of the camera",), because, cure, ()), *gaps)
    if gaps:
        raise SolveError(
            "; ".join(f"unobservable: {', '.join(g.parameters)}, because {g.because}" for g in gaps),
            "; ".join(g.cure for g in gaps),
        )
