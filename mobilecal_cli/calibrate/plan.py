"""Choice of stations; uses the container's index, where possible, to avoid reading all images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import CAMERA_INFO_CHANGES, CameraInfo, IntArray, Rig
from mobilecal_cli.readers import Pictures, Recording, find_pictures, read_signals, read_stamps
from mobilecal_cli.stations import PAIR_AT_REST_S, PAIR_MOVING_S, Plan, plan_stations, with_stamps

#: Below this number of image bytes, one pass over all images is fast and also finds all irregularities in
#: them.
WORTH_BYTES = 2**26
#: Largest share of the bytes for which joints and wheels are read separately.
_MOST_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRecording:
    """The logs of one recording: one, or one for each piece between steps of its clocks.

    Attributes:
        plans: their stations.
        infos: see `Signals`.
        notes: irregularities.
    """

    plans: tuple[Plan, ...]
    infos: Mapping[str, CameraInfo]
    notes: tuple[str, ...]


def plan_recording(
    recording: Recording, rig: Rig, sliding: frozenset[str], everything: bool = False
) -> PlannedRecording:
    """Choose the stations of one recording.

    Args:
        recording: the open recording.
        rig: its topics and the head's joints.
        sliding: names of the prismatic joints.
        everything: see `plan_stations`.

    Raises:
        RecordingError: see `read_signals` and `plan_stations`.
    """
    if not everything and _worth_it(recording, rig):
        pictures = find_pictures(recording, rig.sources.image)
        planned = None if pictures is None else _joints_first(recording, rig, sliding, pictures)
        if planned is not None:
            return planned
    logs = read_signals(recording, rig.sources, rig.chain.joints)
    plans = plan_stations(logs, rig.chain.joints, sliding, everything)
    notes = [
        *(note for signals in logs for note in signals.notes),
        *(note for p in plans for note in p.notes),
    ]
    return PlannedRecording(plans, logs[0].infos, tuple(dict.fromkeys(notes)))


def _worth_it(recording: Recording, rig: Rig) -> bool:
    """Whether the images are stored apart from joints and wheels, and are much larger."""
    motion, images = rig.sources.motion, frozenset(rig.sources.image.values())
    joints_bytes, all_bytes = recording.bytes_of(motion), recording.bytes_of(motion | images)
    return all_bytes - joints_bytes >= WORTH_BYTES and joints_bytes <= _MOST_SHARE * all_bytes


def _joints_first(
    recording: Recording, rig: Rig, sliding: frozenset[str], pictures: Pictures
) -> PlannedRecording | None:
    """Choose the stations by the log times of images; header stamps are read only for the chosen images.

    Returns:
        None if the choice needs all header stamps: those of the sampled images do not tell the others', a clock steps,
        or a camera's calibration changes.
    """
    joints, images = rig.chain.joints, rig.sources.image
    alone, *others = read_signals(recording, replace(rig.sources, image={}), joints, clocks=pictures.clocks)
    if others or any(CAMERA_INFO_CHANGES in note for note in alone.notes):
        return None
    signals = replace(alone, images={side: pictures.index(topic) for side, topic in images.items()})
    try:
        (plan,) = plan_stations([signals], joints, sliding)
    except RecordingError:  # the header stamps may solve this, or give the reason
        return None
    if not plan.stations:
        return None
    at_rest = all(station.at_rest for station in plan.stations)
    # Half of the pairing tolerance: one image may be early, the other late.
    if pictures.spread_ns * 1e-9 > (PAIR_AT_REST_S if at_rest else PAIR_MOVING_S) / 2:
        return None
    logged: dict[str, IntArray] = {}
    for side, index in plan.images.items():
        logged[images[side]] = np.union1d(logged.get(images[side], index.log_ns), index.log_ns)
    found = read_stamps(recording, logged)
    if found is None:
        return None
    own, notes = found
    placed = with_stamps(plan, signals, joints, sliding, {side: own[topic] for side, topic in images.items()})
    if len(placed.stations) < len(plan.stations):
        return None  # the sampled delays do not represent the others
    return PlannedRecording((placed,), {}, (*signals.notes, *notes, *placed.notes))
