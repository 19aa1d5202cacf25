"""Choice of stations; uses the container's index, where possible, to avoid reading all images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

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


#: Stations of each log of one recording (one, or one for each piece between steps of its clocks); its `Signals.infos`;
#: and notes on irregularities.
Planned = tuple[tuple[Plan, ...], Mapping[str, CameraInfo], tuple[str, ...]]


def plan_recording(recording: Recording, rig: Rig, everything: bool = False) -> Planned:
    """Choose the stations of one recording; `everything` as for `plan_stations`.

    Raises:
        RecordingError: see `read_signals` and `plan_stations`.
    """
    motion, images = rig.sources.motion, frozenset(rig.sources.image.values())
    joints_bytes, all_bytes = recording.bytes_of(motion), recording.bytes_of(motion | images)
    # Images that are stored apart from joints and wheels, and are much larger.
    if (
        not everything
        and all_bytes - joints_bytes >= WORTH_BYTES
        and joints_bytes <= _MOST_SHARE * all_bytes
        and (pictures := find_pictures(recording, rig.sources.image)) is not None
        and (planned := _joints_first(recording, rig, pictures)) is not None
    ):
        return planned
    logs = read_signals(recording, rig.sources, rig.chain.joints)
    plans = plan_stations(logs, rig.chain.joints, rig.chain.prismatic, everything)
    noted = (*(signals.notes for signals in logs), *(plan.notes for plan in plans))
    notes = [note for each in noted for note in each]
    return plans, logs[0].infos, tuple(dict.fromkeys(notes))


def _joints_first(recording: Recording, rig: Rig, pictures: Pictures) -> Planned | None:
    """Choose the stations by the log times of images; header stamps are read only for the chosen images.

    Returns:
        None if the choice needs all header stamps: those of the sampled images do not tell the others', a clock steps,
        or a camera's calibration changes.
    """
    joints, sliding, images = rig.chain.joints, rig.chain.prismatic, rig.sources.image
    alone, *others = read_signals(recording, replace(rig.sources, image={}), joints, clocks=pictures.clocks)
    if others or any(CAMERA_INFO_CHANGES in note for note in alone.notes):
        return None
    signals = replace(alone, images={side: pictures.index[topic] for side, topic in images.items()})
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
    stamps = read_stamps(recording, logged)
    if stamps is None:
        return None
    own, notes = stamps
    placed = with_stamps(plan, signals, joints, sliding, {side: own[topic] for side, topic in images.items()})
    if len(placed.stations) < len(plan.stations):
        return None  # the sampled delays do not represent the others
    return (placed,), {}, (*signals.notes, *notes, *placed.notes)
