"""Choice of stations by one pass over the joints, the wheels and the times of the images."""

from __future__ import annotations

from collections.abc import Mapping

from mobilecal_cli.model import CameraInfo, Rig
from mobilecal_cli.readers import Recording, read_signals
from mobilecal_cli.stations import Plan, plan_stations

#: Stations of each log of one recording (one, or one for each piece between steps of its clocks); its `Signals.infos`;
#: and notes on irregularities.
Planned = tuple[tuple[Plan, ...], Mapping[str, CameraInfo], tuple[str, ...]]


def plan_recording(recording: Recording, rig: Rig, everything: bool = False) -> Planned:
    """Choose the stations of one recording; `everything` as for `plan_stations`.

    Raises:
        RecordingError: see `read_signals` and `plan_stations`.
    """
    logs = read_signals(recording, rig.sources, rig.chain.joints)
    plans = plan_stations(logs, rig.chain.joints, rig.chain.prismatic, everything)
    noted = (*(signals.notes for signals in logs), *(plan.notes for plan in plans))
    notes = [note for each in noted for note in each]
    return plans, logs[0].infos, tuple(dict.fromkeys(notes))
