"""Sources of joints, wheels and images: each reads its part of the messages of one topic, all in one pass."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.signals import IMAGES, PictureIndex, Track
from mobilecal_cli.ranges import READING
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, FieldPath, codec_of, content_of, header_stamp_ns
from mobilecal_cli.readers.messages.types import Decoded
from mobilecal_cli.readers.signals.camera_infos import InfoChanges
from mobilecal_cli.readers.signals.series import Clock, Samples

#: Readings of one joint on two topics differ by more than this, rad or m, and this share of their mean deviation.
_DIFFER, _DIFFER_SHARE = 1e-3, 0.3


class Source:
    """A joint, a wheel, or the images of a camera, with its readings: 16 bytes each and 8 for each number.

    Args:
        topic: where the readings come from.
        label: name for messages ("joint head_pan_joint on /joint_states").
        width: numbers of one reading.
        positions: see `Samples`.

    Attributes:
        types: types that the topic may have; () for any.
        impossible: number of readings that are dropped: NaN, infinite or too large.
        missing: number of messages that name the joint or wheel, and have no value of it.
    """

    types: Sequence[str] = ()

    def __init__(self, topic: str, label: str, width: int = 1, positions: bool = False) -> None:
        self.topic, self.label = topic, label
        self._width, self._positions = width, positions
        self._stamp_ns, self._log_ns, self._value = array("q"), array("q"), array("d")
        self.impossible = self.missing = 0
        self._example = 0.0

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        """Read one message; its time is the stamp, or the log time without one."""
        raise NotImplementedError

    def checked(self, notes: list[str]) -> Source:
        """The source in use, after the pass: usually itself; notes what is wrong with its readings.

        Raises:
            RecordingError: they cannot be used.
        """
        return self

    def track(self, samples: Samples, notes: list[str]) -> Track:
        """The track of one piece of the readings, of a joint or a wheel; `notes` receives what is dropped."""
        time_ns, value = samples.ordered(notes)
        return Track(time_ns, value[:, 0])

    def __len__(self) -> int:
        return len(self._stamp_ns)

    @property
    def range(self) -> float:
        """Difference of the largest and the smallest reading; 0 without any."""
        return max(self._value) - min(self._value) if len(self) else 0.0

    @property
    def says(self) -> tuple[bool, bool, int]:
        """How much the readings say: whether any is finite, whether any of these is not zero, and their number."""
        return len(self) > 0, any(self._value), len(self) or self.impossible

    def differs(self, other: Source, from_any_zero: bool = False) -> bool:
        """Whether the readings of the same joint, rad or m, differ in the mean while both were recorded.

        Some publishers repeat the readings of others later, and some wrap them to one turn. Of wheels, two may count
        `from_any_zero`: only rotations from one time to another mean something.
        """
        times_ns, values = (np.array(of, dtype=np.float64) for of in (other._log_ns, other._value))
        own_ns = np.array(self._log_ns, dtype=np.float64)
        both = (times_ns >= own_ns[0]) & (times_ns <= own_ns[-1])
        if not both.any():
            return False
        apart = np.interp(times_ns[both], own_ns, np.array(self._value)) - values[both]
        zero = float(np.angle(np.exp(1j * apart).mean())) if from_any_zero else 0.0
        apart = np.abs(np.remainder(apart - zero + np.pi, 2 * np.pi) - np.pi)
        moved = float(np.abs(values - values.mean()).mean())
        limit = max(_DIFFER, _DIFFER_SHARE * min(moved, np.pi / 2))
        return bool(apart.mean() > limit)

    def add(self, stamp_ns: int, log_ns: int, *value: float) -> None:
        """Append a reading; one that is not finite or too large is counted and dropped."""
        for number in value:
            if number not in READING:
                self._example = self._example if self.impossible else number
                self.impossible += 1
                return
        self._stamp_ns.append(stamp_ns)
        self._log_ns.append(log_ns)
        self._value.extend(value)

    @property
    def impossible_words(self) -> str:
        """Which readings are dropped, with the first of them, "" for none."""
        many = (
            f"{self.impossible} of {self.impossible + len(self)}" if len(self) else f"all {self.impossible}"
        )
        return f"{many} readings are not possible, such as {self._example:.6g} (range {READING})"

    def samples(self, notes: list[str]) -> Samples:
        """All readings that are possible; notes how many are not, and how many are missing.

        Raises:
            RecordingError: there are readings, but none is possible.
        """
        if self.impossible:
            if not len(self):
                raise RecordingError(
                    f"{self.label}: {self.impossible_words}", "check the driver that publishes them"
                )
            notes.append(f"{self.label}: {self.impossible_words}; dropped")
        if self.missing:
            total = self.missing + self.impossible + len(self)
            notes.append(f"{self.label}: {self.missing} of {total} messages have no value; ignored")
        stamp_ns, log_ns = (np.array(times, dtype=np.int64) for times in (self._stamp_ns, self._log_ns))
        value = np.array(self._value, dtype=np.float64).reshape(len(stamp_ns), self._width)
        return Samples(self.topic, self.label, stamp_ns, log_ns, value, positions=self._positions)


AnySource = TypeVar("AnySource", bound=Source)


class FieldSource(Source):
    """The number at a field path of each message, such as a joint's reading.

    Args:
        path: path of the field.
        of: what it is a reading of, for messages.
        setting: key of the path in rig.yaml, for error messages.
        scale: rad (or m) of one unit of the field.

    Raises:
        RecordingError: not a valid path.
    """

    def __init__(self, topic: str, path: str, of: str, setting: str, scale: float = 1.0) -> None:
        super().__init__(topic, f"{of} ({topic} {path})")
        self._path, self._setting, self._scale = FieldPath(path), setting, scale
        self._error: RecordingError | None = None

    def reading(self, value: float) -> float:
        """What is stored of a number."""
        return self._scale * value

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        try:
            value = self._path.number(message, self.topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self.missing += 1
            self._error = self._error or error
            return
        self.add(time_ns, log_ns, self.reading(value))

    def checked(self, notes: list[str]) -> Source:
        """Raise the first error if nothing was read."""
        if self._error is not None and not len(self):
            raise self._error
        return self


class Images(Source):
    """The images of a camera; the value is 1 for an image identical to the one before it.

    Attributes:
        sequential: the images are frames of a video.
    """

    types = IMAGES

    def __init__(self, topic: str) -> None:
        super().__init__(topic, topic)
        self.sequential = False
        self._before = b""

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        if codec_of(message) is not None:
            self.sequential = True
            self.add(time_ns, log_ns, 0.0)
            return
        content = content_of(message)
        self.add(time_ns, log_ns, float(content == self._before != b""))
        self._before = content

    def index(self, samples: Samples, notes: list[str]) -> PictureIndex:
        """The images of one piece of the recording; `notes` receives what is dropped and repeated."""
        keep = samples.kept(notes)
        new = samples.value[:, 0] == 0
        since = np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))
        if repeated := int(np.sum(keep & ~new)):
            notes.append(
                f"{samples.label}: {repeated} of {len(new)} images are identical to the image before them; each "
                "picture is used once, and only until the robot moves"
            )
        arrays = (samples.time_ns[keep], samples.stamp_ns[keep], samples.log_ns[keep])
        return PictureIndex(*arrays, self.sequential, samples.time_ns[since][keep])


class Subscriptions:
    """Decodes each message of a recording once, and passes it to all sources that read its topic.

    Attributes:
        clocks: statistics of the stamps of each topic.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.clocks: dict[str, Clock] = {}
        self._takers: dict[str, list[Callable[[Decoded, int, int], None]]] = {}

    def add(self, source: AnySource) -> AnySource:
        """Read a source's topic.

        Raises:
            RecordingError: the topic is missing, or has another type.
        """
        topic = source.topic
        info = self.recording.topic(topic)
        if source.types and info.type not in source.types:
            wanted = " or ".join(source.types)
            raise RecordingError(
                f"{self.recording.name}: {topic} has the type {info.type}, expected {wanted}",
                "set a topic of this type in rig.yaml",
            )
        self.clocks.setdefault(topic, Clock(topic))
        self._takers.setdefault(topic, []).append(source.take)
        return source

    def run(self, extent: Extent, infos: Mapping[str, InfoChanges]) -> None:
        """Run the pass, which also compares the calibrations on the topics of cameras, `infos`."""
        for channel, log_ns, payload in self.recording.messages(self.clocks.keys() | infos.keys(), extent):
            topic = channel.topic
            if topic not in self.clocks:
                infos[topic].add(channel, log_ns, payload)
                continue
            try:
                message = channel.decode(payload)
                stamp_ns = header_stamp_ns(message)
                for take in self._takers[topic]:
                    take(message, stamp_ns or log_ns, log_ns)
                self.clocks[topic].count(stamp_ns, log_ns)
            except (RecordingError, *NOT_ITS_TYPE):
                self.clocks[topic].broken += 1

    def checked(self, source: Source, notes: list[str]) -> Source:
        """The source in use, after the pass; see `Source.checked`.

        Raises:
            RecordingError: nothing was read.
        """
        clock = self.clocks[source.topic]
        if not clock.messages:
            if not clock.broken:
                raise self.recording.nothing_read(clock.topic)
            raise RecordingError(
                f"{self.recording.name}: {clock.topic}: none of its {clock.broken} messages can be decoded",
                "record the topic, or set another one in rig.yaml",
            )
        return source.checked(notes)
