"""Joints: read from joint states, from transforms, or from a field of any message."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import JOINT_STATE, FloatArray, JointTransform, Track, listed
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import Channel, FieldPath, Payload, header_stamp_ns, stamp_of
from mobilecal_cli.readers.signals.series import Samples, Series

#: The stamp follows the encapsulation (CDR) or the sequence number (ROS 1), 4 bytes each.
_STAMP, _STAMP_END = struct.Struct("<iI"), 12
_COUNT = struct.Struct("<I")
_LITTLE_ENDIAN = b"\x00\x01"
#: Publishers that share a topic have messages of different lengths; where more lengths occur, the names change.
_MOST_KNOWN = 64


@dataclass(frozen=True, slots=True)
class JointReading:
    """One message of joint states.

    Attributes:
        stamp_ns: header stamp, 0 if it is zero, None without a header.
        names: the joints.
        position, velocity: a number for each joint; either may be shorter, or empty.
    """

    stamp_ns: int | None
    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]


class JointStateDecoder:
    """Decoder of the joint states of one channel.

    Most messages of a publisher have the frame and names of the one before. Then only the stamp and the numbers are
    read, three times faster than by the message definition.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._aligned = channel.encoding == "cdr"
        self._repeats = channel.type == JOINT_STATE and channel.encoding in ("cdr", "ros1")
        #: Length of a message → bytes between stamp and positions, and the names in them.
        self._known: dict[int, tuple[bytes, Sequence[str]]] = {}

    def __call__(self, payload: Payload) -> JointReading:
        """Decode a message.

        Raises:
            RecordingError: it does not match its type.
        """
        head, names = self._known.get(len(payload), (b"", ()))
        if head and payload[_STAMP_END : _STAMP_END + len(head)] == head:
            with suppress(struct.error):  # truncated: the other way states what is wrong
                return self._numbers(payload, _STAMP_END + len(head), names)
        message = self._channel.decode(payload)
        position, velocity = (getattr(message, field, ()) for field in ("position", "velocity"))
        reading = JointReading(header_stamp_ns(message), tuple(message.name), position, velocity)
        if self._repeats:
            self._learn(payload, str(message.header.frame_id), reading)
        return reading

    def _learn(self, payload: Payload, frame: str, reading: JointReading) -> None:
        """Store the bytes of frame and names, if the numbers are found after them."""
        if self._aligned and payload[:2] != _LITTLE_ENDIAN:
            return
        at = self._align(_STAMP_END, 4) + 4 + len(frame.encode()) + self._aligned  # CDR counts a final zero
        at = self._align(at, 4) + 4
        for name in reading.names:
            at = self._align(at, 4) + 4 + len(name.encode()) + self._aligned
        with suppress(struct.error):
            again = self._numbers(payload, at, reading.names)
            if (again.stamp_ns, *map(_bytes, (again.position, again.velocity))) == (
                reading.stamp_ns,
                *map(_bytes, (reading.position, reading.velocity)),
            ):
                self._repeats = len(self._known) < _MOST_KNOWN
                self._known[len(payload)] = bytes(payload[_STAMP_END:at]), reading.names

    def _numbers(self, payload: Payload, at: int, names: Sequence[str]) -> JointReading:
        seconds, nanoseconds = _STAMP.unpack_from(payload, 4)
        position, at = self._list(payload, at)
        velocity, at = self._list(payload, at)
        _COUNT.unpack_from(payload, self._align(at, 4))  # of the efforts, whose numbers are not used
        return JointReading(seconds * 10**9 + nanoseconds, names, position, velocity)

    def _list(self, payload: Payload, at: int) -> tuple[tuple[float, ...], int]:
        """A list of numbers, and the byte after it."""
        at = self._align(at, 4)
        (count,) = _COUNT.unpack_from(payload, at)
        at += 4
        if not count:
            return (), at
        at = self._align(at, 8)
        return struct.unpack_from(f"<{count}d", payload, at), at + 8 * count

    def _align(self, at: int, size: int) -> int:
        """The next byte at which a number of some size may begin, counted from the end of the encapsulation."""
        return at + (4 - at) % size if self._aligned else at


def _bytes(numbers: Sequence[float]) -> bytes:
    return np.asarray(numbers, dtype=np.float64).tobytes()


#: Names that are kept for messages; where each message has others, all of them would fill the memory.
_MOST_PRESENT = 1000


class JointStates:
    """Positions and velocities of named joints on one topic.

    Attributes:
        position: name → readings, of the subscribed joints.
        velocity: the same, of joints whose velocities are used.
        present: names found, in order: those of the subscribed joints, and a thousand others.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.position: dict[str, Series] = {}
        self.velocity: dict[str, Series] = {}
        self.present: dict[str, None] = {}
        self._names: Sequence[str] | None = None
        self._places: list[tuple[int, Series, str]] = []

    def want(self, name: str, *, velocity: bool = False) -> None:
        """Subscribe to a joint."""
        self.position.setdefault(name, Series(self.topic, f"joint {name} on {self.topic}"))
        if velocity:
            self.velocity.setdefault(name, Series(self.topic, f"velocity of joint {name} on {self.topic}"))

    def take(self, reading: JointReading, stamp_ns: int, log_ns: int) -> None:
        """Read one message; the order of names may change from message to message."""
        if reading.names is not self._names:
            self._names = reading.names
            names = list(reading.names)
            self.present.update(dict.fromkeys(names[: max(_MOST_PRESENT - len(self.present), 0)]))
            self.present.update(dict.fromkeys(name for name in self.position if name in names))
            self._places = [
                (names.index(name), series, field)
                for field in ("position", "velocity")
                for name, series in getattr(self, field).items()
                if name in names
            ]
        for place, series, field in self._places:
            values = getattr(reading, field)
            if place < len(values):
                series.add(stamp_ns, log_ns, float(values[place]))


#: A transform that deviates by more from the motion of its joint belongs to another robot or URDF.
_OFF_RAD, _OFF_M = 0.02, 0.005
#: Bytes of a recording that are read for its transforms, and samples stored of each.
_SAMPLED_BYTES, _MOST_SAMPLES = 2**28, 400


class Transforms:
    """Joints in the transforms of one topic.

    Args:
        joints: name → its transform.

    Attributes:
        series: name → readings.
    """

    def __init__(self, topic: str, joints: Mapping[str, JointTransform]) -> None:
        self._topic = topic
        self._joints = dict(joints)
        self._wanted = {(source.parent, source.child): name for name, source in joints.items()}
        self.series = {name: Series(topic, f"joint {name} on {topic}") for name in joints}
        self._worst = dict.fromkeys(joints, (0.0, 0.0))
        self._present: dict[str, None] = {}

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one TFMessage."""
        for item in message.transforms:
            ends = (item.header.frame_id.lstrip("/"), item.child_frame_id.lstrip("/"))
            name = self._wanted.get(ends)
            if name is None:
                if len(self._present) < 40:
                    self._present[" to ".join(ends)] = None
                continue
            value, off_rad, off_m = reading(self._joints[name], item.transform)
            self.series[name].add(stamp_of(item, time_ns), log_ns, value)
            worst = self._worst[name]
            self._worst[name] = (max(worst[0], off_rad), max(worst[1], off_m))

    def check(self, name: str, notes: list[str]) -> None:
        """Check the readings of a joint, and note where they come from.

        Raises:
            RecordingError: its transform is missing, or does not move as the URDF states.
        """
        source, series = self._joints[name], self.series[name]
        if not len(series) and not series.not_finite:
            raise RecordingError(
                f"{self._topic}: no transform from {source.parent} to {source.child}, needed for joint {name}; "
                f"present: {listed(self._present)}",
                "record /joint_states, or use the URDF that the transforms were computed with",
            )
        off_rad, off_m = self._worst[name]
        if off_rad > _OFF_RAD or off_m > _OFF_M:
            raise RecordingError(
                f"{self._topic}: the transform from {source.parent} to {source.child} deviates from joint {name} "
                f"by up to {math.degrees(off_rad):.1f} degrees and {off_m * 1e3:.0f} mm "
                f"(limit {math.degrees(_OFF_RAD):.1f} degrees, {_OFF_M * 1e3:.0f} mm)",
                "use the URDF that the transforms were computed with",
            )
        notes.append(f"{series.label}: read from the transform from {source.parent} to {source.child}")

    def track(self, name: str, samples: Samples, notes: list[str]) -> Track:
        """Track of a joint."""
        time_ns, value = samples.ordered(notes)
        return Track(
            time_ns, value[:, 0] if self._joints[name].kind == "prismatic" else np.unwrap(value[:, 0])
        )


def transforms_of(recording: Recording, topics: Sequence[str]) -> dict[tuple[str, str], FloatArray]:
    """Samples of all transforms of a recording, (parent, child) → (n, 4, 4), m; a long recording is read in parts."""
    samples_of: dict[tuple[str, str], list[FloatArray]] = {}
    for message in recording.messages(topics, Extent(_SAMPLED_BYTES)) if topics else ():
        try:
            items = message.decode().transforms
        except (RecordingError, AttributeError):
            continue
        for item in items:
            try:
                ends = (str(item.header.frame_id).lstrip("/"), str(item.child_frame_id).lstrip("/"))
                T = _matrix(item.transform)
            except (AttributeError, TypeError, ValueError):  # JSON may contain anything
                continue
            if T is not None:
                samples = samples_of.setdefault(ends, [])
                samples.append(T)
                if len(samples) > _MOST_SAMPLES:  # keep the first and every second of the others
                    del samples[1::2]
    return {ends: np.stack(samples) for ends, samples in samples_of.items()}


def _matrix(transform: Any) -> FloatArray | None:  # noqa: ANN401
    """(4, 4) of a geometry_msgs/Transform, None if it is not finite."""
    q, t = transform.rotation, transform.translation
    quaternion, place = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
    if not (np.isfinite(quaternion).all() and np.isfinite(place).all() and np.linalg.norm(quaternion) > 0.5):
        return None
    return se3.transform(se3.from_quaternion_xyzw(quaternion / np.linalg.norm(quaternion)), place)


def reading(source: JointTransform, transform: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Position of a joint from the transform of its link.

    Returns:
        rad (or m), and deviation of the transform from the joint's motion: rad, m. NaN if the transform is not finite.
    """
    T = _matrix(transform)
    if T is None:
        return math.nan, 0.0, 0.0
    moved: FloatArray = se3.inverse(source.T_parent_child) @ T
    turn = se3.log_so3(moved[:3, :3])
    if source.kind == "prismatic":
        way = float(source.axis @ moved[:3, 3])
        return way, float(np.linalg.norm(turn)), float(np.linalg.norm(moved[:3, 3] - way * source.axis))
    # The axis is known, so this also works near half a turn, where the logarithm may choose the other sign.
    R, a = moved[:3, :3], source.axis
    angle = math.atan2(
        float(a @ np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])), float(np.trace(R) - 1)
    )
    rest = se3.log_so3(se3.rotation_about(a, np.array(-angle)) @ R)
    return angle, float(np.linalg.norm(rest)), float(np.linalg.norm(moved[:3, 3]))


class FieldSeries:
    """The number at a field path of each message on a topic.

    Args:
        setting: key of the path in rig.yaml, for error messages.
        series: receives the readings.
        scaled: value that is added to the series for a number.

    Raises:
        RecordingError: not a valid path.
    """

    def __init__(self, path: str, setting: str, series: Series, scaled: Callable[[float], float]) -> None:
        self._path, self._setting = FieldPath.parse(path), setting
        self._series, self._scaled = series, scaled
        self._missing = 0
        self._error: RecordingError | None = None

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        try:
            value = self._path.number(message, self._series.topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self._missing += 1
            self._error = self._error or error
            return
        self._series.add(time_ns, log_ns, self._scaled(value))

    def check(self, notes: list[str]) -> None:
        """Note missing readings; raise the first error if nothing was read."""
        if self._error is not None:
            if not len(self._series):
                raise self._error
            notes.append(f"{self._series.label}: the field is missing in {self._missing} messages; ignored")
