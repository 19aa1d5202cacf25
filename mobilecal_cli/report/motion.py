"""Motion that a recording lacks: before a solve, what it leaves unobservable, and after one, what was too little."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import (
    DRIVEN_RAD,
    TILTED_RAD,
    TURNED_RAD,
    cut_at,
    encoder_steps_rad,
    head_pose,
    motion_seen,
    unseen_height,
)
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.rig import HeadChain
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.report.numbers import rejection_counts

_HEAD_M = 0.5  # that the motion of a head alone moves a camera, at most


def nearer(extraction: Extraction) -> str:
    """How to record again where most rejected stations show squares that are too small, "" elsewhere."""
    often = next(iter(rejection_counts(extraction)), None)
    if often is None or often[1] != Reason.TOO_SMALL:
        return ""
    said = next(item.detail for item in extraction.rejections if item.reason == Reason.TOO_SMALL)
    said = said.partition("(")[2].partition(")")[0] or said
    return f"record closer to the board, or with larger squares (for example: {said})"


class Extent(NamedTuple):
    """An extent of the motion. With a small one, a parameter depends on a difference about as small as the noise.

    Attributes:
        least: limit.
        unit: "degrees" or "m".
        digits: decimals to show.
        of_head: whether it is of the head, and not of the base.
        name: label.
        too_small: what is wrong with a small one, "{}" for its value.
        cure: as a command.
    """

    least: float
    unit: str
    digits: int
    of_head: bool
    name: str
    too_small: str
    cure: str

    def text(self, value: float) -> str:
        """A value with its unit."""
        return f"{value:.{self.digits}f} {self.unit}"


#: Keys of `Solution.motion`.
MOTION = {
    "pan_range_deg": Extent(10.0, "degrees", 1, True, "pan range of the head", "the head panned by {} only",
                            "pan the head by 20 degrees or more between stops"),
    "tilt_range_deg": Extent(5.0, "degrees", 1, True, "tilt range of the head", "the head tilted by {} only",
                             "tilt the head up and down by 15 degrees or more between stops"),
    "turned_deg": Extent(20.0, "degrees", 1, False, "rotation of the base", "the base turned by {} only",
                         "turn the base by 20 degrees or more between stops"),
    "driven_m": Extent(0.2, "m", 2, False, "path length of the base", "the base drove {} only",
                       "drive forward and back by 20 cm or more between stops"),
}  # fmt: skip


def small_motion(motion: Mapping[str, float], names: Collection[str]) -> dict[str, Extent]:
    """Extents below their limits, by their keys: of the head or of the base, that show some of these parameters."""
    return {
        key: extent
        for key, extent in MOTION.items()
        if motion.get(key, extent.least) < extent.least
        and not set(NINE[:6] if extent.of_head else NINE[6:]).isdisjoint(names)
    }


def motion_cure(motion: Mapping[str, float], names: Collection[str]) -> str:
    """What to do about motion too small to show these parameters, as sentences; "" where it is enough."""
    small = small_motion(motion, names).items()
    return " ".join(f"{extent.cure.capitalize()} (now {extent.text(motion[key])})." for key, extent in small)


def missing_motion(motion: Mapping[str, float], names: Sequence[str], chain: HeadChain) -> tuple[str, str]:
    """Which motion was too little to determine these parameters, and what adds it, as a command.

    Args:
        motion: see `Solution.motion`.
        names: some of `NINE`, at least one.
        chain: base to head.
    """
    small = small_motion(motion, names)
    too_little = [extent.too_small.format(extent.text(motion[key])) for key, extent in small.items()]
    cures, turns = [extent.cure for extent in small.values()], "turned_deg" in small
    if set(names) & set(NINE[6:]) and not turns and "driven_m" not in small:
        driven, turned = (MOTION[key].text(motion[key]) for key in ("driven_m", "turned_deg"))
        too_little.append(
            f"the base drove {driven} and turned by {turned}, too nearly in one proportion for its noise"
        )
        cures.append("turn in place at some stops, and drive straight between others")
        turns = True
    shows_head = "tilt_range_deg" if unseen_height(chain) is None else "turned_deg"
    told = turns if shows_head == "turned_deg" else shows_head in small
    if set(names) & set(NINE[:6]) and not told:
        cures.insert(0, MOTION[shows_head].cure)
    return " and ".join(too_little), "; ".join(cures)


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
    motion = motion_seen(head_pose(chain, joints), np.concatenate(Phi), encoder_steps_rad(tuple(wheels)))
    gaps = []
    if not motion.tilts and unseen_height(chain) is None:
        gaps.append(
            Gap(
                ("translation along the vertical", "rotation about the vertical"),
                f"the head's tilt spans only {np.degrees(motion.tilted_rad):.2f} degrees "
                f"(at least {np.degrees(TILTED_RAD):.0f} needed)",
                f"{MOTION['tilt_range_deg'].cure}, and pan it",
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
        because, cure = f"the base stands still: {rotate}", "drive and turn the base between stops"
        if seen_m > _HEAD_M:
            because = f"the images show a drive of {seen_m:.1f} m, but {rotate}"
            cure = "check the unit and ticks_per_revolution of the wheel readings, and that these are of this drive"
        gaps.append(Gap(NINE[6:], because, cure, (NINE[6:],)))
    elif not motion.turns:
        because = (
            f"the base only drives straight: the rotations of the two wheels differ by at most "
            f"{np.degrees(turned):.1f} degrees between stations (at least {np.degrees(TURNED_RAD):.1f} needed)"
        )
        cure = MOTION["turned_deg"].cure
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
        gaps.append(Gap((scale,), because, MOTION["driven_m"].cure, tuple((name,) for name in NINE[6:])))
    return tuple(gaps)
