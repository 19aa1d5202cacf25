"""Choice of stations; uses the container's index, where possible, to avoid reading all images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import Rig, Side
from mobilecal_cli.readers import Pictures, Recording, find_pictures, read_signals, read_stamps
from mobilecal_cli.stations import PAIR_AT_REST_S, PAIR_MOVING_S, Plan, plan_stations, with_stamps

#: Below this number of image bytes, one pass over all images is fast and also finds all irregularities in
#: them.
WORTH_BYTES = 2**26
#: Largest share of the bytes for which joints and wheels are read separately.
_MOST_SHARE = 0.5
_SIDES: tuple[Side, Side] = ("left", "right")


def plan_log(
    recording: Recording, rig: Rig, sliding: frozenset[str], everything: bool = False
) -> tuple[Plan, tuple[str, ...]]:
    """Choose the stations of one recording.

    Args:
        recording: the open recording.
        rig: its topics and the head's joints.
        sliding: names of the prismatic joints.
        everything: see `plan_stations`.

    Returns:
        The plan, and notes on irregularities.

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
    """Whether the images are stored apart from joints and wheels, and are much larger."""
    motion, images = rig.sources.motion, frozenset(rig.sources.image.values())
    joints_bytes, all_bytes = recording.bytes_of(motion), recording.bytes_of(motion | images)
    return all_bytes - joints_bytes >= WORTH_BYTES and joints_bytes <= _MOST_SHARE * all_bytes


def _joints_first(
    recording: Recording, rig: Rig, sliding: frozenset[str], pictures: Pictures
) -> tuple[Plan, tuple[str, ...]] | None:
    """Choose the stations by the log times of images; header stamps are read only for the chosen images.

    Returns:
        None if the choice needs all header stamps.
    """
    joints, images = rig.chain.joints, rig.sources.image
    alone = read_signals(recording, rig.sources, joints, (), clocks=pictures.clocks)
    signals = replace(alone, image_ns={side: pictures.stamps(images[side]) for side in _SIDES})
    try:
        plan = plan_stations(signals, joints, sliding)
    except RecordingError:  # the header stamps may solve this, or give the reason
        return None
    if not plan.stations:
        return None
    at_rest = all(station.at_rest for station in plan.stations)
    # Half of the pairing tolerance: one image may be early, the other late.
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
        return None  # the sampled delays do not represent the others
    return settled, (*signals.notes, *notes, *settled.notes)
