"""Joints, wheels and images of a recording over time."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import RecordingError, usable
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.model.rig import SIDES, JointField, JointSource, Sources
from mobilecal_cli.model.signals import CAMERA_INFO, CLOCKS_DIFFER, IMAGES, PictureIndex, Signals, Track
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, header_stamp_ns
from mobilecal_cli.readers.signals.camera_infos import InfoChanges
from mobilecal_cli.readers.signals.joints import StatedJoint, TransformJoint
from mobilecal_cli.readers.signals.series import (
    LAGS,
    Clock,
    Samples,
    clock_notes,
    cut,
    end_notes,
    pause_notes,
    with_rests,
    without_stale,
    without_strays,
)
from mobilecal_cli.readers.signals.sides import sides_of
from mobilecal_cli.readers.signals.sources import FieldSource, Images, Source, Subscriptions
from mobilecal_cli.readers.signals.wheels import OdometryWheel, add_wheel, gap_notes


def _joint(name: str, where: JointSource) -> Source:
    if isinstance(where, str):
        return StatedJoint(where, name)
    if isinstance(where, JointField):
        return FieldSource(where.topic, where.field, f"joint {name}", "joints.fields", where.scale)
    return TransformJoint(name, where)


def clocks_that_differ(recording: Recording, topics: Iterable[str]) -> list[str]:
    """A note on topics with stamps from different clocks, from the first messages of each, if there are any."""
    clocks = [Clock(topic) for topic in topics]
    for clock in clocks:
        for channel, log_ns, payload in itertools.islice(recording.messages([clock.topic]), LAGS):
            with suppress(RecordingError, *NOT_ITS_TYPE):
                clock.count(header_stamp_ns(channel.decode(payload)), log_ns)
    return [note for note in clock_notes(clocks) if note.startswith(CLOCKS_DIFFER)]


def read_signals(recording: Recording, sources: Sources, extent: Extent = EVERYTHING) -> tuple[Signals, ...]:
    """Read everything except image contents, in one pass.

    Time is the header stamp if it is not zero, otherwise the log time. Of equal stamps the first is kept; of stamps out
    of order the longest run in order is kept (`series.in_order`). Impossible readings and undecodable messages
    are dropped, and so are images recorded while a camera info differs from most of its topic. Notes give the counts.

    Wheels from joint states keep the driver's zero; counters and integrated velocities start at zero.

    Args:
        sources: the topics to read; without image topics, no images are read.
        extent: how much of the recording is read.

    Returns:
        The pieces of the recording between the steps of its clocks (`series.cut`), usually one; notes on all of it are
        in the first. A piece without readings of a joint or wheel, or without images, is left out and noted.

    Raises:
        RecordingError: a topic, joint or field is missing (the message lists what is present), a topic has the wrong
            type, a camera has no images, or a joint or wheel has no possible reading.
    """
    read = Subscriptions(recording)
    images = {name: read.add(Images(topic)) for name, topic in sources.image.items()}
    joints = {name: read.add(_joint(name, where)) for name, where in sources.joints.items()}
    turning = {side: [add_wheel(read, side, wheel) for wheel in sources.wheels[side].every] for side in SIDES}
    infos = {
        info.name: InfoChanges(info.name)
        for info in recording.topics
        if info.type == CAMERA_INFO and info.name in sources.info.values()
    }
    read.run(extent, infos)

    notes: list[str] = []
    for camera in images.values():
        read.checked(camera, notes)
    for side, each in turning.items():
        turning[side] = used = [read.checked(wheel, notes) for wheel in each]
        silent = [wheel for wheel in used if wheel.impossible and not len(wheel)]
        if 0 < len(silent) < len(used):
            notes += (f"{wheel.label}: {wheel.impossible_words}; left out" for wheel in silent)
            turning[side] = [wheel for wheel in used if wheel not in silent]
    for joint in joints.values():
        read.checked(joint, notes)
    sources_used: list[Source] = [*images.values(), *joints.values(), *itertools.chain(*turning.values())]
    samples = without_strays([source.samples(notes) for source in sources_used], notes)
    pieces, steps = cut(samples)
    changes = [note for topic in infos.values() for note in topic.notes(recording.start_ns)]
    notes = [
        *clock_notes(read.clocks.values()),
        *steps,
        *end_notes(samples),
        *pause_notes(samples),
        *changes,
        *notes,
    ]
    of_none = {info.name for info in recording.topics if info.type in IMAGES} - {*sources.image.values()}
    logged = recording.log_times() if images and of_none else {}
    corrected = {name: topic.infos[topic.usual] for name, topic in infos.items() if topic.usual}

    def signals_of(recorded: Mapping[Source, Samples]) -> Signals:
        own_notes: list[str] = []
        samples = {source: each.arranged(own_notes) for source, each in recorded.items()}

        def track_of(source: Source) -> Track:
            return with_rests(
                without_stale(source.label, source.track(samples[source], own_notes), own_notes)
            )

        tracks = {name: track_of(joint) for name, joint in joints.items()}
        times_ns = np.concatenate([each.time_ns for each in samples.values()])
        for name, joint in joints.items():
            if len(joint) == 1 and not joint.impossible:
                own_notes.append(f"{joint.label}: one reading only; the joint counts as standing still")
                still = np.repeat(tracks[name].value, 2)
                tracks[name] = Track(np.array([times_ns.min(), times_ns.max()]), still)
        wheels = sides_of(
            {side: [(wheel.label, track_of(wheel)) for wheel in each] for side, each in turning.items()},
            own_notes,
        )
        indices: dict[str, PictureIndex] = {}
        recorded_ns: dict[str, IntArray] = {}
        for name, camera in images.items():
            index = camera.index(samples[camera], own_notes)
            stated = infos.get(sources.info.get(name, ""))
            indices[name] = index.rows(stated.usual_at(index.log_ns)) if stated else index
            recorded_ns[name] = index.time_ns
            if not len(indices[name].time_ns):
                raise RecordingError(f"{camera.topic}: no usable images", "record all cameras the whole time")
        for side, track in wheels.items():
            own_notes += gap_notes(f"{side} wheel", track)
        lags_ns = [index.log_ns - index.time_ns for index in indices.values()]
        lag_ns = int(np.median(np.concatenate(lags_ns))) if lags_ns else 0
        unused = {topic: logged[topic] - lag_ns for topic in sorted(of_none & logged.keys())}
        of_odometry = (
            wheel for each in turning.values() for wheel in each if isinstance(wheel, OdometryWheel)
        )
        ahead_m = next((wheel.ahead_m for wheel in of_odometry), 0.0)
        return Signals(tracks, wheels, indices, tuple(own_notes), recorded_ns, corrected, unused, ahead_m)

    logs, problems = usable([dict(zip(sources_used, piece, strict=True)) for piece in pieces], signals_of)
    notes += (
        f"piece {number} of {len(pieces)} of the recording is not used: {error.message}"
        for number, error in problems.items()
    )
    first, *others = logs
    return (replace(first, notes=tuple(dict.fromkeys([*notes, *first.notes]))), *others)
