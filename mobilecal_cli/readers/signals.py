"""One pass over a recording: joints, wheels and image stamps."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    IMAGES,
    JOINT_STATE,
    IntArray,
    JointField,
    JointTransform,
    Side,
    Signals,
    Sources,
    Track,
    WheelSource,
)
from mobilecal_cli.readers.channels import NOT_ITS_TYPE, Channel, Payload
from mobilecal_cli.readers.fields import FieldPath
from mobilecal_cli.readers.info_changes import InfoChanges
from mobilecal_cli.readers.joint_states import Columns, JointStates
from mobilecal_cli.readers.odometry import Odometry
from mobilecal_cli.readers.recording import Recording
from mobilecal_cli.readers.series import Series, TickCounter, gap_notes, order_notes, wheel_track
from mobilecal_cli.readers.stamps import Clock, clock_notes
from mobilecal_cli.readers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.transforms import Transforms
from mobilecal_cli.readers.video import codec_of

SIDES: tuple[Side, Side] = ("left", "right")

Taker = Callable[[Any, int], None]


def read_signals(
    recording: Recording,
    sources: Sources,
    joints: Sequence[str],
    sides: Sequence[Side] = SIDES,
    extent: Extent = EVERYTHING,
    clocks: Sequence[Clock] = (),
) -> Signals:
    """Read everything except image contents, in one pass.

    Time is the header stamp if it is not zero, otherwise the log time. Of equal stamps the first is kept; where a clock
    steps back, the longest run in order is kept (`stamps.in_order`). Readings that are not finite and undecodable
    messages are dropped. Notes give the counts, and changes of the cameras' calibration.

    Wheels from joint states keep the driver's zero; counters and integrated velocities start at zero.

    Args:
        recording: the open recording.
        sources: the topics to read.
        joints: names of the head's joints.
        sides: the sides whose image stamps are read.
        extent: how much of the recording is read.
        clocks: clocks of topics that are read elsewhere, to be compared with the others.

    Raises:
        RecordingError: a topic, joint or field is missing (the message lists what is present), a topic has the wrong
            type, a side has no images, or a joint or wheel has no finite reading.
    """
    reader = _Reader(recording)
    for side in sides:
        reader.image(side, sources.image[side])
    for topic in sources.joints:
        reader.joints(topic, [name for name in joints if name not in sources.elsewhere])
    reader.joints_elsewhere(sources.elsewhere)
    for side in SIDES:
        reader.wheel(side, sources.wheels[side])
    infos = InfoChanges(recording, sources.info.values())
    together = extent is EVERYTHING and infos.cheap_with(reader.topics)
    reader.run(extent, infos if together else None)
    if not together:
        infos.sample()

    notes = list(infos.notes)
    images = {side: reader.image_stamps(side, sources.image[side], notes) for side in sides}
    tracks = {name: reader.joint_track(name, sources.joints, notes) for name in joints}
    wheels: dict[Side, Track] = {}
    for side in SIDES:
        wheels[side] = reader.wheel_track(side, sources.wheels[side], notes)
        notes += gap_notes(f"{side} wheel", wheels[side])
    notes = [*clock_notes([*reader.clocks.values(), *clocks]), *reader.undecodable(), *notes]
    return Signals(tracks, wheels, images, tuple(dict.fromkeys(notes)))


def _scaled(series: Series, scale: float, time_ns: int, value: float) -> None:
    series.add(time_ns, value * scale)


class _Field:
    """A number at a field path, over time.

    Args:
        topic, path: its location.
        setting: key of the path in rig.yaml, for error messages.
        series: receives the readings.
        add: adds a reading to the series.
    """

    def __init__(
        self, topic: str, path: str, setting: str, series: Series, add: Callable[[int, float], None]
    ) -> None:
        self._topic, self._setting = topic, setting
        self._path = FieldPath.parse(path)
        self._series, self._add = series, add
        self._missing = 0
        self._error: RecordingError | None = None

    def take(self, message: Any, time_ns: int) -> None:  # noqa: ANN401
        """Read one message."""
        try:
            value = self._path.number(message, self._topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self._missing += 1
            self._error = self._error or error
            return
        self._add(time_ns, value)

    def track(self, notes: list[str]) -> Track:
        """The track; raises the error if nothing was read, notes missing readings."""
        if self._error is not None:
            if not len(self._series):
                raise self._error
            notes.append(f"{self._series.label}: the field is missing in {self._missing} messages; ignored")
        time_ns, value = self._series.ordered(notes)
        return Track(time_ns, value)


@dataclass(frozen=True, slots=True)
class _Apart:
    """A joint or wheel that is read from messages other than JointState.

    Attributes:
        topic: topic of the messages.
        track: returns the track after the pass; its argument receives notes.
    """

    topic: str
    track: Callable[[list[str]], Track]


class _Reader:
    """Decodes each message once, and passes it to all subscribers of its topic."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.clocks: dict[str, Clock] = {}
        self._takers: dict[str, list[Taker]] = {}
        self._stamps: dict[Side, array[int]] = {}
        self._joints: dict[str, JointStates] = {}
        self._joints_apart: dict[str, _Apart] = {}
        self._wheels_apart: dict[Side, _Apart] = {}
        self._odometry: Odometry | None = None
        self._broken: dict[str, int] = {}
        self._pictured: dict[str, dict[int, int]] = {}

    def _subscribe(self, topic: str, taker: Taker) -> None:
        takers = self._takers.setdefault(topic, [])
        if taker not in takers:
            takers.append(taker)
        self.clocks.setdefault(topic, Clock(topic))

    def _of_type(self, topic: str, types: Sequence[str], hint: str) -> None:
        info = self.recording.topic(topic)
        if info.type not in types:
            wanted = " or ".join(types)
            raise RecordingError(
                f"{self.recording.name}: {topic} has the type {info.type}, expected {wanted}", hint
            )

    def image(self, side: Side, topic: str) -> None:
        """Collect the stamps of a side's images."""
        self._of_type(topic, IMAGES, f"correct cameras.{side}.image in rig.yaml")
        stamps = self._stamps[side] = array("q")
        self._pictured[topic] = self.recording.logged.setdefault(topic, {})
        self._subscribe(topic, lambda _, time_ns: stamps.append(time_ns))

    def joints(self, topic: str, names: Sequence[str]) -> None:
        """Collect joints of a topic."""
        self._of_type(topic, (JOINT_STATE,), "set a JointState topic in rig.yaml (a wheel may use a field)")
        group = self._joints.setdefault(topic, JointStates(topic))
        for name in names:
            group.want(name)
        self._subscribe(topic, group.take)

    def joints_elsewhere(self, sources: Mapping[str, JointField | JointTransform]) -> None:
        """Collect joints from messages other than JointState."""
        moved: dict[str, dict[str, JointTransform]] = {}
        for name, source in sources.items():
            self.recording.topic(source.topic)
            if isinstance(source, JointTransform):
                moved.setdefault(source.topic, {})[name] = source
                continue
            series = Series(f"joint {name} ({source.topic} {source.field})")
            add = partial(_scaled, series, source.scale)
            field = _Field(source.topic, source.field, "joints.fields", series, add)
            self._joints_apart[name] = _Apart(source.topic, field.track)
            self._subscribe(source.topic, field.take)
        for topic, joints in moved.items():
            transforms = Transforms(topic, joints)
            self._joints_apart |= {name: _Apart(topic, partial(transforms.track, name)) for name in joints}
            self._subscribe(topic, transforms.take)

    def wheel(self, side: Side, source: WheelSource) -> None:
        """Collect a wheel's readings."""
        if source.joint is not None:
            self.joints(source.topic, [source.joint])
            return
        if source.baked_in is not None:
            if self._odometry is None:
                self._odometry = Odometry(source.topic, source.baked_in)
                self._subscribe(source.topic, self._odometry.take)
            self._wheels_apart[side] = _Apart(source.topic, partial(self._odometry.track, side))
            return
        if source.field is None:
            raise RecordingError(
                f"{side} wheel: neither joint nor field is set for {source.topic}",
                f"set wheels.{side}.joint or wheels.{side}.field in rig.yaml",
            )
        self.recording.topic(source.topic)
        series = Series(f"{side} wheel ({source.topic} {source.field})")
        add = TickCounter(series, source).add
        field = _Field(source.topic, source.field, f"wheels.{side}.field", series, add)
        self._wheels_apart[side] = _Apart(source.topic, field.track)
        self._subscribe(source.topic, field.take)

    @property
    def topics(self) -> frozenset[str]:
        """All topics that are read."""
        return frozenset(self._takers)

    def run(self, extent: Extent, infos: InfoChanges | None = None) -> None:
        """Run the pass, which may also compare the cameras' calibrations."""
        # If only joints are read from a topic, its messages can be read in batches.
        columns = {
            topic: Columns(joints, self.clocks[topic], self._take)
            for topic, joints in self._joints.items()
            if self._takers[topic] == [joints.take]
        }
        compared = infos.topics - self.topics if infos is not None else frozenset()
        for channel, log_ns, payload in self.recording.raw(self.topics | compared, extent):
            if infos is not None and channel.topic in compared:
                infos.add(channel, log_ns, payload)
            elif channel.topic in columns:
                columns[channel.topic].add(channel, log_ns, payload)
            else:
                self._take(channel, log_ns, payload)
        for waiting in columns.values():
            waiting.read()

    def _take(self, channel: Channel, log_ns: int, payload: Payload) -> None:
        """Pass on one message."""
        topic = channel.topic
        try:
            decoded = channel.decode(payload)
            time_ns = self.clocks[topic].time_ns(decoded, log_ns)
            for take in self._takers[topic]:
                take(decoded, time_ns)
            if topic in self._pictured and codec_of(decoded) is None:
                self._pictured[topic].setdefault(time_ns, log_ns)
        except (RecordingError, *NOT_ITS_TYPE):
            self._broken[topic] = self._broken.get(topic, 0) + 1

    def undecodable(self) -> list[str]:
        """Notes on messages that do not match their type."""
        return [
            f"{topic}: {self._broken[topic]} of {self._broken[topic] + clock.messages} messages do not match their "
            "type; ignored"
            for topic, clock in self.clocks.items()
            if topic in self._broken
        ]

    def image_stamps(self, side: Side, topic: str, notes: list[str]) -> IntArray:
        """Stamps of a side's images, strictly increasing."""
        stamps: IntArray = np.array(self._stamps[side], dtype=np.int64)
        if not len(stamps):
            broken = self._broken.get(topic, 0)
            fact = f"none of its {broken} messages can be decoded" if broken else "it has no messages"
            raise RecordingError(
                f"{self.recording.name}: no images of the {side} camera on {topic}: {fact}",
                "record both cameras, or set other topics in rig.yaml",
            )
        keep, found = order_notes(topic, stamps)
        notes += found
        kept: IntArray = stamps[keep]
        return kept

    def _present(self, topics: Sequence[str]) -> str:
        names = dict.fromkeys(name for topic in topics for name in self._joints[topic].present)
        return ", ".join(names) or "none"

    def joint_track(self, name: str, topics: Sequence[str], notes: list[str]) -> Track:
        """Track of a head joint, from its own field or the JointState topic with most of its readings."""
        if name in self._joints_apart:
            return self._read(self._joints_apart[name], notes)
        found = [self._joints[topic].position[name] for topic in topics]
        best = max(found, key=len, default=None)
        if best is None or not len(best):
            bad = next((series for series in found if series.not_finite), None)
            if bad is not None:
                bad.ordered(notes)  # raises: no finite reading
            where = ", ".join(topics) or "any topic"
            raise RecordingError(
                f"{self.recording.name}: no position of joint {name} on {where}; "
                f"joints present: {self._present(topics)}",
                "correct joints in rig.yaml, or the URDF's joint names",
            )
        time_ns, value = best.ordered(notes)
        return Track(time_ns, value)

    def wheel_track(self, side: Side, source: WheelSource, notes: list[str]) -> Track:
        """Rotation of a wheel, rad, positive forward."""
        if side in self._wheels_apart:
            return self._read(self._wheels_apart[side], notes)
        group, name = self._joints[source.topic], source.joint or ""
        if name not in group.present:
            if not self.clocks[source.topic].messages:
                raise self._empty(source.topic)
            raise RecordingError(
                f"{self.recording.name}: no joint {name} on {source.topic}; "
                f"joints present: {self._present([source.topic])}",
                f"correct wheels.{side}.joint in rig.yaml",
            )
        return wheel_track(group.position[name], group.velocity[name], source, notes)

    def _read(self, apart: _Apart, notes: list[str]) -> Track:
        if not self.clocks[apart.topic].messages:
            raise self._empty(apart.topic)
        return apart.track(notes)

    def _empty(self, topic: str) -> RecordingError:
        broken = self._broken.get(topic, 0)
        fact = f"none of its {broken} messages can be decoded" if broken else "no messages"
        return RecordingError(
            f"{self.recording.name}: {topic}: {fact}", "record the topic, or set another one in rig.yaml"
        )
