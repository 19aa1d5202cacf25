"""Joints, wheels and stamps into a plan; where the container's index allows it, without reading all the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import Rig, Side
from mobilecal_cli.readers import Pictures, Recording, find_pictures, read_signals, read_stamps
from mobilecal_cli.stations import PAIR_AT_REST_S, PAIR_MOVING_S, Plan, plan_stations, with_stamps

#: With fewer bytes of images one pass over all of them is quick, and tells of everything that is odd in them.
WORTH_BYTES = 2**26
#: Joints and wheels are read by themselves where they take no more than this share of the pass.
_MOST_SHARE = 0.5
_SIDES: tuple[Side, Side] = ("left", "right")


def plan_log(
    recording: Recording, rig: Rig, sliding: frozenset[str], everything: bool = False
) -> tuple[Plan, tuple[str, ...]]:
    """Find the moments of one log at which the board may be looked at.

    Args:
        recording: the open recording.
        rig: its topics and the head's joints.
        sliding: those joints that slide.
        everything: see `plan_stations`.

    Returns:
        The plan, and notes on what was odd.

    Raises:
        RecordingError: see `read_signals` and `plan_stations`.
    """
    if not everything and _worth_it(recording, rig):
        pictures = find_pictures(recording, rig.sources.image)
        planned = None if pictures is None else _joints_first(recording, rig, sliding, pictures)
        if planned is not None:
            return planned
    signals = read_signals(recording, rig.sources, rig.chain.joints)
    plan = plan_stations(signals, rig.chain.joints, sliding, everything)
    return plan, (*signals.notes, *plan.notes)


def _worth_it(recording: Recording, rig: Rig) -> bool:
    """Whether the images lie apart from joints and wheels, and are much more."""
    motion, images = rig.sources.motion, frozenset(rig.sources.image.values())
    joints_bytes, all_bytes = recording.bytes_of(motion), recording.bytes_of(motion | images)
    return all_bytes - joints_bytes >= WORTH_BYTES and joints_bytes <= _MOST_SHARE * all_bytes


def _joints_first(
    recording: Recording, rig: Rig, sliding: frozenset[str], pictures: Pictures
) -> tuple[Plan, tuple[str, ...]] | None:
    """Choose the stations by when images were logged; only of the chosen ones the stamps are read.

    Returns:
        None where the images' own stamps are needed to choose by.
    """
    joints, images = rig.chain.joints, rig.sources.image
    alone = read_signals(recording, rig.sources, joints, (), clocks=pictures.clocks)
    signals = replace(alone, image_ns={side: pictures.stamps(images[side]) for side in _SIDES})
    try:
        plan = plan_stations(signals, joints, sliding)
    except RecordingError:  # the stamps themselves may do, or tell why not
        return None
    if not plan.stations:
        return None
    at_rest = all(station.at_rest for station in plan.stations)
    # Half of what keeps two images from being a pair: one of them may come sooner, the other later.
    if pictures.spread_ns * 1e-9 > (PAIR_AT_REST_S if at_rest else PAIR_MOVING_S) / 2:
        return None
    planned_ns: dict[Side, list[int]] = {
        "left": [shot.left_ns for station in plan.stations for shot in station.shots],
        "right": [shot.right_ns for station in plan.stations for shot in station.shots],
    }
    logged: dict[str, set[int]] = {}
    for side, planned in planned_ns.items():
        lag_ns = pictures.lag_ns[images[side]]
        logged.setdefault(images[side], set()).update(time_ns + lag_ns for time_ns in planned)
    found = read_stamps(recording, {topic: np.array(sorted(times)) for topic, times in logged.items()})
    if found is None:
        return None
    own, notes = found
    stamps = {
        side: {time_ns - pictures.lag_ns[topic]: stamp_ns for time_ns, stamp_ns in own[topic].items()}
        for side, topic in images.items()
    }
    settled = with_stamps(plan, signals, joints, sliding, stamps)
    if len(settled.stations) < len(plan.stations):
        return None  # the few lags were no guide
    return settled, (*signals.notes, *notes, *settled.notes)
