"""Joints, wheels and images of a recording over time: what is read from each topic, and the pass that reads it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    IMAGES,
    JOINT_STATE,
    SIDES,
    IntArray,
    JointField,
    JointTransform,
    PictureIndex,
    Side,
    Signals,
    Sources,
    Track,
    WheelSource,
    camera_words,
    listed,
)
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, Channel, Payload, content_of, header_stamp_ns
from mobilecal_cli.readers.pixels import codec_of
from mobilecal_cli.readers.signals.camera_infos import InfoChanges
from mobilecal_cli.readers.signals.joints import FieldSeries, JointStates, Transforms
from mobilecal_cli.readers.signals.series import (
    Clock,
    Samples,
    Series,
    clock_notes,
    cut,
    pause_notes,
)
from mobilecal_cli.readers.signals.wheels import (
    Counter,
    Odometry,
    from_positions,
    from_velocities,
    gap_notes,
    sides_of,
)

#: Takes a message, its time (stamp or log time) and its log time.
Taker = Callable[[Any, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A joint or a wheel.

    Attributes:
        series: its readings.
        track: makes a track from one piece of them; the second argument receives notes.
        check: raises or notes what is wrong with them, after the pass.
        instead: the velocities, which are used if there are no positions.
    """

    series: Series
    track: Callable[[Samples, list[str]], Track]
    check: Callable[[list[str]], None] = lambda _: None
    instead: Quantity | None = None


class Subscriptions:
    """Decodes each message of a recording once, and passes it to all that read its topic.

    Attributes:
        clocks: statistics of the stamps of each topic.
        video: topics with video.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.clocks: dict[str, Clock] = {}
        self.video: set[str] = set()
        self._takers: dict[str, list[Taker]] = {}
        self._joints: dict[str, JointStates] = {}
        self._odometry: dict[str, Odometry] = {}

    def _subscribe(self, topic: str, taker: Taker) -> None:
        self._takers.setdefault(topic, []).append(taker)
        self.clocks.setdefault(topic, Clock(topic))

    def _of_type(self, topic: str, types: Sequence[str], hint: str) -> None:
        info = self.recording.topic(topic)
        if info.type not in types:
            wanted = " or ".join(types)
            raise RecordingError(
                f"{self.recording.name}: {topic} has the type {info.type}, expected {wanted}", hint
            )

    def images(self, name: str, topic: str) -> Series:
        """Collect the stamps of a camera's images; the value is 1 for an image identical to the one before it."""
        self._of_type(topic, IMAGES, f"correct cameras.{name}.image in rig.yaml")
        stamps = Series(topic, topic)
        before = b""

        def take(message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401
            nonlocal before
            if codec_of(message) is not None:
                self.video.add(topic)
                stamps.add(time_ns, log_ns, 0.0)
                return
            content = content_of(message)
            stamps.add(time_ns, log_ns, float(content == before != b""))
            before = content

        self._subscribe(topic, take)
        return stamps

    def joints(self, topic: str, names: Sequence[str], *, velocity: bool = False) -> None:
        """Collect joints of a topic."""
        self._of_type(topic, (JOINT_STATE,), "set a JointState topic in rig.yaml (a wheel may use a field)")
        if topic not in self._joints:
            self._joints[topic] = JointStates(topic)
            self._subscribe(topic, self._joints[topic].take)
        for name in names:
            self._joints[topic].want(name, velocity=velocity)

    def joints_elsewhere(self, sources: Mapping[str, JointField | JointTransform]) -> dict[str, Quantity]:
        """Collect joints from messages other than JointState."""
        elsewhere: dict[str, Quantity] = {}
        moved: dict[str, dict[str, JointTransform]] = {}
        for name, source in sources.items():
            self.recording.topic(source.topic)
            if isinstance(source, JointTransform):
                moved.setdefault(source.topic, {})[name] = source
                continue
            series = Series(source.topic, f"joint {name} ({source.topic} {source.field})")
            field = FieldSeries(source.field, "joints.fields", series, source.scale.__mul__)
            self._subscribe(source.topic, field.take)
            elsewhere[name] = Quantity(series, _plain_track, field.check)
        for topic, joints in moved.items():
            transforms = Transforms(topic, joints)
            self._subscribe(topic, transforms.take)
            for name, series in transforms.series.items():
                track, check = partial(transforms.track, name), partial(transforms.check, name)
                elsewhere[name] = Quantity(series, track, check)
        return elsewhere

    def wheel(self, side: Side, source: WheelSource) -> Quantity:
        """Collect the readings of one wheel of a side."""
        topic, joint = source.topic, source.joint
        if joint is not None:
            self.joints(topic, [joint], velocity=True)
            position, velocity = self._joints[topic].position[joint], self._joints[topic].velocity[joint]
            return Quantity(
                position,
                partial(from_positions, source),
                partial(self._check_wheel, side, topic, joint),
                Quantity(velocity, partial(from_velocities, source)),
            )
        if source.baked_in is not None:
            if topic not in self._odometry:
                self._odometry[topic] = Odometry(topic, source.baked_in, assumed=source.assumed)
                self._subscribe(topic, self._odometry[topic].take)
            odometry = self._odometry[topic]
            return Quantity(odometry.series, partial(odometry.track, side))
        assert source.field is not None  # a source has one of the three
        self.recording.topic(topic)
        series = Series(topic, f"{side} wheel ({topic} {source.field})")
        counter = Counter(series.label, source.bits)
        field = FieldSeries(source.field, f"wheels.{side}.field", series, counter.since_first)
        self._subscribe(topic, field.take)

        def check(notes: list[str]) -> None:
            counter.check()
            field.check(notes)

        return Quantity(series, partial(from_positions, source), check)

    @property
    def topics(self) -> frozenset[str]:
        """All topics that are read."""
        return frozenset(self.clocks)

    def run(self, extent: Extent, infos: InfoChanges | None = None) -> None:
        """Run the pass, which may also compare the cameras' calibrations."""
        compared = infos.topics - self.topics if infos is not None else frozenset()
        for channel, log_ns, payload in self.recording.messages(self.topics | compared, extent):
            if infos is not None and channel.topic in compared:
                infos.add(channel, log_ns, payload)
            else:
                self._take(channel, log_ns, payload)

    def _take(self, channel: Channel, log_ns: int, payload: Payload) -> None:
        """Pass on one message."""
        topic = channel.topic
        try:
            message = channel.decode(payload)
            stamp_ns = header_stamp_ns(message)
            for take in self._takers[topic]:
                take(message, stamp_ns or log_ns, log_ns)
            self.clocks[topic].count(stamp_ns, log_ns)
        except (RecordingError, *NOT_ITS_TYPE):
            self.clocks[topic].broken += 1

    def undecodable(self) -> list[str]:
        """Notes on messages that do not match their type."""
        return [
            f"{topic}: {clock.broken} of {clock.broken + clock.messages} messages do not match their type; ignored"
            for topic, clock in self.clocks.items()
            if clock.broken
        ]

    def check_images(self, name: str, series: Series) -> None:
        """Check that a camera has images.

        Raises:
            RecordingError: it has none.
        """
        if not len(series):
            broken = self.clocks[series.topic].broken
            fact = f"none of its {broken} messages can be decoded" if broken else "it has no messages"
            raise RecordingError(
                f"{self.recording.name}: no images of the {camera_words(name)} on {series.topic}: {fact}",
                "record all cameras, or set other topics in rig.yaml",
            )

    def joint_quantity(self, name: str, topics: Sequence[str]) -> Quantity:
        """A head joint from the JointState topic with most of its readings."""
        quantities = [self._joints[topic].position[name] for topic in topics]
        best = max(quantities, key=len, default=None)
        if best is None or not (len(best) or any(series.not_finite for series in quantities)):
            where = ", ".join(topics) or "any topic"
            raise RecordingError(
                f"{self.recording.name}: no position of joint {name} on {where}; "
                f"joints present: {self._present(topics)}",
                "correct joints in rig.yaml, or the URDF's joint names",
            )
        if not len(best):
            best = max(quantities, key=lambda series: series.not_finite)
        best.check_alternation()
        return Quantity(best, _plain_track)

    def _check_wheel(self, side: Side, topic: str, joint: str, _: list[str]) -> None:
        """Check that joint states have positions or velocities of a wheel."""
        group = self._joints[topic]
        if joint not in group.present:
            raise RecordingError(
                f"{self.recording.name}: no joint {joint} on {topic}; joints present: {self._present([topic])}",
                f"correct wheels.{side}.joint in rig.yaml",
            )
        position = group.position[joint]
        if not (len(position) or position.not_finite or len(group.velocity[joint])):
            raise RecordingError(
                f"{position.label}: neither positions nor velocities in its messages",
                "set another source for the wheel in rig.yaml",
            )
        position.check_alternation()

    def _present(self, topics: Sequence[str]) -> str:
        return listed(dict.fromkeys(name for topic in topics for name in self._joints[topic].present))

    def checked(self, quantity: Quantity, notes: list[str]) -> Quantity:
        """What there is of a joint or wheel after the pass.

        Raises:
            RecordingError: nothing.
        """
        series, other = quantity.series, quantity.instead
        clock = self.clocks[series.topic]
        if not clock.messages:
            fact = f"none of its {clock.broken} messages can be decoded" if clock.broken else "no messages"
            raise RecordingError(
                f"{self.recording.name}: {series.topic}: {fact}",
                "record the topic, or set another one in rig.yaml",
            )
        quantity.check(notes)
        if other is None or len(series) or not len(other.series):
            return quantity
        if series.not_finite:
            notes.append(f"{series.label}: all {series.not_finite} positions are NaN or infinite")
        notes.append(f"{series.label}: no positions; velocities are integrated")
        return other


def _plain_track(samples: Samples, notes: list[str]) -> Track:
    time_ns, value = samples.ordered(notes)
    return Track(time_ns, value[:, 0])


def read_signals(
    recording: Recording,
    sources: Sources,
    joints: Sequence[str],
    extent: Extent = EVERYTHING,
) -> tuple[Signals, ...]:
    """Read everything except image contents, in one pass.

    Time is the header stamp if it is not zero, otherwise the log time. Of equal stamps the first is kept; of stamps out
    of order the longest run in order is kept (`stamps.in_order`). Readings that are not finite and undecodable messages
    are dropped, and so are images recorded while a camera info differs from most of its topic. Notes give the counts.

    Wheels from joint states keep the driver's zero; counters and integrated velocities start at zero.

    Args:
        sources: the topics to read; without image topics, no images are read.
        extent: how much of the recording is read.

    Returns:
        The pieces of the recording between the steps of its clocks (see `steps`), usually one; notes on all of it are
        in the first. A piece without readings of a joint or wheel, or without images, is left out and noted.

    Raises:
        RecordingError: a topic, joint or field is missing (the message lists what is present), a topic has the wrong
            type, a camera has no images, or a joint or wheel has no finite reading.
    """
    read = Subscriptions(recording)
    images = {name: read.images(name, topic) for name, topic in sources.image.items()}
    for topic in sources.joints:
        read.joints(topic, [name for name in joints if name not in sources.elsewhere])
    elsewhere = read.joints_elsewhere(sources.elsewhere)
    wheels = {side: [read.wheel(side, wheel) for wheel in sources.wheels[side].every] for side in SIDES}
    infos = InfoChanges(recording, sources.info.values())
    if extent is EVERYTHING:
        read.run(extent, infos)
    else:
        read.run(extent)
        infos.sample()

    notes: list[str] = []
    for name, series in images.items():
        read.check_images(name, series)
    turning = {side: [read.checked(wheel, notes) for wheel in wheels[side]] for side in SIDES}
    moving = {
        name: read.checked(elsewhere[name], notes)
        if name in elsewhere
        else read.joint_quantity(name, sources.joints)
        for name in joints
    }
    read_over_time = (*moving.values(), *(wheel for side in SIDES for wheel in turning[side]))
    every = dict.fromkeys([*images.values(), *(each.series for each in read_over_time)])
    samples = [series.samples(notes) for series in every]
    pieces, steps = cut(samples)
    notes = [
        *clock_notes(list(read.clocks.values())),
        *read.undecodable(),
        *steps,
        *pause_notes(samples),
        *infos.notes,
        *notes,
    ]

    def signals_of(recorded: Mapping[Series, Samples]) -> Signals:
        some: list[str] = []
        samples = {series: each.arranged(some) for series, each in recorded.items()}
        tracks = {name: _track(joint, samples, some) for name, joint in moving.items()}
        times_ns = np.concatenate([each.time_ns for each in samples.values()])
        for name, joint in moving.items():
            if len(joint.series) == 1 and not joint.series.not_finite:
                some.append(f"{joint.series.label}: one reading only; the joint counts as standing still")
                still = np.repeat(tracks[name].value, 2)
                tracks[name] = Track(np.array([times_ns.min(), times_ns.max()]), still)
        wheels = sides_of(
            {
                side: [(wheel.series.label, _track(wheel, samples, some)) for wheel in each]
                for side, each in turning.items()
            },
            some,
        )
        indices: dict[str, PictureIndex] = {}
        left_out_ns: dict[str, IntArray] = {}
        for camera, series in images.items():
            index = _index(samples[series], series.topic in read.video, some)
            usual = infos.usual_at(sources.info.get(camera, ""), index.log_ns)
            indices[camera], left_out_ns[camera] = index.rows(usual), np.delete(index.time_ns, usual)
            if not len(indices[camera].time_ns):
                raise RecordingError(f"{series.topic}: no usable images", "record all cameras the whole time")
        for side, track in wheels.items():
            some += gap_notes(f"{side} wheel", track)
        return Signals(tracks, wheels, indices, tuple(some), infos.corrected, left_out_ns)

    return _usable([dict(zip(every, piece, strict=True)) for piece in pieces], signals_of, notes)


def _track(quantity: Quantity, samples: Mapping[Series, Samples], notes: list[str]) -> Track:
    own = samples[quantity.series]
    if not len(own):
        raise RecordingError(f"{own.label}: no readings", "record the topic during the whole recording")
    return quantity.track(own, notes)


def _index(samples: Samples, sequential: bool, notes: list[str]) -> PictureIndex:
    keep = samples.kept(notes)
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
