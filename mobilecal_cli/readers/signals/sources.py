"""Sources of joints, wheels and images: each reads its part of the messages of one topic, all in one pass."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import IMAGES, PictureIndex, Track
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, FieldPath, content_of, header_stamp_ns
from mobilecal_cli.readers.messages.types import Decoded
from mobilecal_cli.readers.pixels import codec_of
from mobilecal_cli.readers.signals.camera_infos import InfoChanges
from mobilecal_cli.readers.signals.series import Clock, Samples, Series


class Source:
    """A joint, a wheel, or the images of a camera.

    Attributes:
        series: the readings; after `check`, those in use.
        types: types that the topic may have; () for any.
    """

    types: Sequence[str] = ()

    def __init__(self, series: Series) -> None:
        self.series = series

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        """Read one message; its time is the stamp, or the log time without one."""
        raise NotImplementedError

    def check(self, notes: list[str]) -> None:
        """Note what is wrong with the readings, after the pass.

        Raises:
            RecordingError: they cannot be used.
        """

    def track(self, samples: Samples, notes: list[str]) -> Track:
        """The track of one piece of the readings, of a joint or a wheel; `notes` receives what is dropped."""
        time_ns, value = samples.ordered(notes)
        return Track(time_ns, value[:, 0])


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
        super().__init__(Series(topic, f"{of} ({topic} {path})"))
        self._path, self._setting, self._scale = FieldPath.parse(path), setting, scale
        self._missing = 0
        self._error: RecordingError | None = None

    def reading(self, value: float) -> float:
        """What is stored of a number."""
        return self._scale * value

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        try:
            value = self._path.number(message, self.series.topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self._missing += 1
            self._error = self._error or error
            return
        self.series.add(time_ns, log_ns, self.reading(value))

    def check(self, notes: list[str]) -> None:
        """Note missing readings; raise the first error if nothing was read."""
        if self._error is not None:
            if not len(self.series):
                raise self._error
            notes.append(f"{self.series.label}: the field is missing in {self._missing} messages; ignored")


class Images(Source):
    """The images of a camera; the value is 1 for an image identical to the one before it.

    Attributes:
        sequential: the images are frames of a video.
    """

    types = IMAGES

    def __init__(self, topic: str) -> None:
        super().__init__(Series(topic, topic))
        self.sequential = False
        self._before = b""

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        if codec_of(message) is not None:
            self.sequential = True
            self.series.add(time_ns, log_ns, 0.0)
            return
        content = content_of(message)
        self.series.add(time_ns, log_ns, float(content == self._before != b""))
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
        topic = source.series.topic
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

    def check(self, source: Source, notes: list[str]) -> None:
        """Check a source after the pass; see `Source.check`.

        Raises:
            RecordingError: nothing was read.
        """
        clock = self.clocks[source.series.topic]
        if not clock.messages:
            fact = f"none of its {clock.broken} messages can be decoded" if clock.broken else "no messages"
            raise RecordingError(
                f"{self.recording.name}: {clock.topic}: {fact}",
                "record the topic, or set another one in rig.yaml",
            )
        source.check(notes)
