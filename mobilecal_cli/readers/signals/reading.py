"""Joints, wheels and images of a recording over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import PictureIndex, Side, Signals, Sources, Track
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.signals.clocks import Clock, clock_notes
from mobilecal_cli.readers.signals.info_changes import InfoChanges
from mobilecal_cli.readers.signals.series import Samples, Series, order_notes
from mobilecal_cli.readers.signals.steps import cut, pause_notes
from mobilecal_cli.readers.signals.subscriptions import Quantity, Subscriptions
from mobilecal_cli.readers.signals.wheels import gap_notes

SIDES: tuple[Side, Side] = ("left", "right")


def read_signals(
    recording: Recording,
    sources: Sources,
    joints: Sequence[str],
    extent: Extent = EVERYTHING,
    clocks: Sequence[Clock] = (),
) -> tuple[Signals, ...]:
    """Read everything except image contents, in one pass.

    Time is the header stamp if it is not zero, otherwise the log time. Of equal stamps the first is kept; of stamps out
    of order the longest run in order is kept (`stamps.in_order`). Readings that are not finite and undecodable messages
    are dropped, and so are images recorded while a camera info differs from most of its topic. Notes give the counts.

    Wheels from joint states keep the driver's zero; counters and integrated velocities start at zero.

    Args:
        recording: the open recording.
        sources: the topics to read; without image topics, no images are read.
        joints: names of the head's joints.
        extent: how much of the recording is read.
        clocks: clocks of topics that are read elsewhere, to be compared with the others.

    Returns:
        The pieces of the recording between the steps of its clocks (see `steps`), usually one; notes on all of it are
        in the first. A piece without readings of a joint or wheel, or without images, is left out and noted.

    Raises:
        RecordingError: a topic, joint or field is missing (the message lists what is present), a topic has the wrong
            type, a side has no images, or a joint or wheel has no finite reading.
    """
    read = Subscriptions(recording)
    images = {side: read.images(side, topic) for side, topic in sources.image.items()}
    for topic in sources.joints:
        read.joints(topic, [name for name in joints if name not in sources.elsewhere])
    read.joints_elsewhere(sources.elsewhere)
    for side in SIDES:
        read.wheel(side, sources.wheels[side])
    infos = InfoChanges(recording, sources.info.values())
    together = extent is EVERYTHING and infos.cheap_with(read.topics)
    read.run(extent, infos if together else None)
    if not together:
        infos.sample()

    notes: list[str] = []
    for side, series in images.items():
        read.check_images(side, series)
    turning = {side: read.wheel_quantity(side, sources.wheels[side], notes) for side in SIDES}
    moving = {name: read.joint_quantity(name, sources.joints, notes) for name in joints}
    every = dict.fromkeys([*images.values(), *(one.series for one in (*moving.values(), *turning.values()))])
    samples = [series.samples(notes) for series in every]
    pieces, steps = cut(samples)
    notes = [
        *clock_notes([*read.clocks.values(), *clocks]),
        *read.undecodable(),
        *steps,
        *pause_notes(samples),
        *infos.notes,
        *notes,
    ]

    def signals_of(samples: Mapping[Series, Samples]) -> Signals:
        some: list[str] = []
        tracks = {name: _track(one, samples, some) for name, one in moving.items()}
        wheels = {side: _track(one, samples, some) for side, one in turning.items()}
        found: dict[Side, PictureIndex] = {}
        for side, series in images.items():
            index = _index(samples[series], series.topic in read.video, some)
            found[side] = index.rows(infos.usual_at(sources.info.get(side, ""), index.log_ns))
            if not len(found[side].time_ns):
                raise RecordingError(
                    f"{series.topic}: no usable images", "record both cameras the whole time"
                )
        for side, track in wheels.items():
            some += gap_notes(f"{side} wheel", track)
        return Signals(tracks, wheels, found, tuple(some), infos.corrected)

    return _usable([dict(zip(every, piece, strict=True)) for piece in pieces], signals_of, notes)


def _track(quantity: Quantity, samples: Mapping[Series, Samples], notes: list[str]) -> Track:
    own = samples[quantity.series]
    if not len(own):
        raise RecordingError(f"{own.label}: no readings", "record the topic during the whole recording")
    return quantity.track(own, notes)


def _index(samples: Samples, sequential: bool, notes: list[str]) -> PictureIndex:
    keep, found = order_notes(samples.label, samples.stamp_ns)
    notes += found
    new = samples.value[:, 0] == 0
    since = np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))
    if repeated := int(np.sum(keep & ~new)):
        notes.append(
            f"{samples.label}: {repeated} of {len(new)} images are identical to the image before them; each picture "
            "is used once, and only until the robot moves"
        )
    arrays = (samples.time_ns[keep], samples.stamp_ns[keep], samples.log_ns[keep])
    return PictureIndex(*arrays, sequential, samples.time_ns[since][keep])


def _usable(
    pieces: Sequence[Mapping[Series, Samples]],
    signals_of: Callable[[Mapping[Series, Samples]], Signals],
    notes: list[str],
) -> tuple[Signals, ...]:
    """Signals of the pieces that have all readings; the notes are added to the first of them.

    Raises:
        RecordingError: that of the first piece, if none has.
    """
    usable: list[Signals] = []
    problems: list[RecordingError] = []
    for number, piece in enumerate(pieces, 1):
        try:
            usable.append(signals_of(piece))
        except RecordingError as error:
            problems.append(error)
            notes.append(f"piece {number} of {len(pieces)} of the recording is not used: {error.message}")
    if not usable:
        raise problems[0]
    first, *others = usable
    return (replace(first, notes=tuple(dict.fromkeys([*notes, *first.notes]))), *others)
