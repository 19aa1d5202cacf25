"""A recording: one or more files, read as one stream of messages."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from mobilecal_cli.errors import MobilecalError, RecordingError
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.model.signals import TopicInfo
from mobilecal_cli.model.text import listed
from mobilecal_cli.readers.containers.storage import COUNTED, EVERYTHING, Extent, Message, Storage


@contextmanager
def boundary(path: Path) -> Iterator[None]:
    """Convert what third-party readers raise on damaged files to `RecordingError`."""
    try:
        yield
    except (MobilecalError, MemoryError):
        raise
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be read: {error.strerror or error}", "check the path and its permissions"
        ) from error
    except Exception as error:
        raise RecordingError(
            f"{path}: damaged and unreadable ({type(error).__name__}: {error})",
            "copy the recording again, or repair it (mcap recover, rosbag reindex, ros2 bag reindex)",
        ) from error


class Recording(ExitStack):
    """An open recording. Use it as a context manager, or close it.

    Attributes:
        paths: as given by the user.
        parts: the open files, in order of time.
        stated: topic → message count in metadata.yaml, if there is one.
        topics: what the files contain.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        super().__init__()
        self.paths = tuple(paths)
        self.parts: list[Storage] = []
        self.stated: Counter[str] = Counter()
        self.topics: tuple[TopicInfo, ...] = ()
        self._notes: dict[str, None] = {}

    def complete(self) -> None:
        """Bring the parts in order of time, and list the topics, after all parts are added."""
        self.parts.sort(key=lambda part: part.start_ns if part.start_ns is not None else -1)
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for part in self.parts:
            for number, channel in part.channels.items():
                types.setdefault(channel.topic, channel.ros_type)
                counts[channel.topic] += part.counts[number]
        self.topics = tuple(TopicInfo(topic, types[topic], counts[topic]) for topic in sorted(types))
        self._by_name = {info.name: info for info in self.topics}

    @property
    def name(self) -> str:
        """Name of the recording, for messages."""
        more = f" and {len(self.paths) - 1} more" if len(self.paths) > 1 else ""
        return f"{self.paths[0]}{more}"

    @property
    def topic_names(self) -> Set[str]:
        """Names of the topics."""
        return self._by_name.keys()

    @property
    def start_ns(self) -> int | None:
        """Log time of the first message, None if unknown."""
        return min((part.start_ns for part in self.parts if part.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Log time of the last message, None if unknown."""
        return max((part.end_ns for part in self.parts if part.end_ns is not None), default=None)

    @property
    def damage(self) -> tuple[str, ...]:
        """Data that was lost, as sentences with numbers; complete after a full pass."""
        return tuple(dict.fromkeys(chain(self._notes, *(part.damage for part in self.parts))))

    def note(self, sentence: str) -> None:
        """Add a remark; a repeated one counts once."""
        self._notes[sentence] = None

    def topic(self, name: str) -> TopicInfo:
        """Information on one topic.

        Raises:
            RecordingError: the topic is not in the recording; the message lists those present.
        """
        if name in self._by_name:
            return self._by_name[name]
        present = listed(f"{info.name} ({info.type})" for info in self.topics)
        raise RecordingError(
            f"{self.name}: no topic {name}; topics present: {present}", "set one of them in rig.yaml"
        )

    def nothing_read(self, topic: str) -> RecordingError:
        """The error for a topic without any message that can be read: what is damaged, if messages were recorded."""
        count, causes = self.topic(topic).count, [note for note in self.damage if not note.endswith(COUNTED)]
        if not count or not causes:
            return RecordingError(
                f"{self.name}: {topic}: no messages", "record the topic, or set another one in rig.yaml"
            )
        why = min(causes, key=lambda note: topic not in note)
        return RecordingError(
            f"{topic}: none of its {count} messages can be read ({why})",
            "copy the recording again, or record a new one",
        )

    @property
    def containers(self) -> tuple[str, ...]:
        """Container formats of the files."""
        return tuple(dict.fromkeys(part.container for part in self.parts))

    def log_times(self) -> dict[str, IntArray]:
        """Topic → (n,) log times in file order; only topics whose times are available without reading all."""
        times: dict[str, list[IntArray]] = {}
        unknown = set()
        for part in self.parts:
            numbers, log_ns = part.log_times()
            for number, channel in part.channels.items():
                own_ns = log_ns[numbers == number]
                if len(own_ns):
                    times.setdefault(channel.topic, []).append(own_ns)
                elif part.counts[number]:
                    unknown.add(channel.topic)
        return {topic: np.concatenate(some) for topic, some in times.items() if topic not in unknown}

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        """Number of bytes that `messages` reads for the topics."""
        own = self._of_part(extent)
        return sum(part.bytes_of(topics, own) for part in self.parts)

    def share(self, topics: Collection[str], extent: Extent) -> float:
        """Share of the bytes of `messages` that an extent leaves, 0 to 1."""
        every = self.bytes_of(topics)
        return self.bytes_of(topics, extent) / every if every else 1.0

    def _of_part(self, extent: Extent) -> Extent:
        """The share of an extent for each file."""
        if extent.within_bytes is None:
            return extent
        return replace(extent, within_bytes=extent.within_bytes // len(self.parts))

    def messages(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[Message]:
        """The topics' messages in order of log time.

        Consecutive files are read one after the other; files that overlap in time are merged.

        Args:
            topics: the topics to read.
            extent: the part of the recording to read.

        Raises:
            RecordingError: a topic is missing, its encoding is not supported, or a file is damaged and unreadable.
        """
        names = frozenset(topics)
        for name in sorted(names):
            self.topic(name)
        for error in self.unsupported(names).values():
            raise error
        return self._stream(names, extent)

    def unsupported(self, topics: Collection[str]) -> dict[str, RecordingError]:
        """Those of the topics whose encoding is not supported → the error; one pass over all channels."""
        names, errors = frozenset(topics), dict[str, RecordingError]()
        for part in self.parts:
            for channel in part.channels.values():
                if channel.topic in names and channel.topic not in errors:
                    try:
                        channel.check()
                    except RecordingError as error:
                        errors[channel.topic] = error
        return errors

    def _stream(self, topics: frozenset[str], extent: Extent) -> Iterator[Message]:
        read = dict.fromkeys(topics, 0)
        own = self._of_part(extent)
        for group in _overlapping(self.parts):
            streams = [self._part(part, topics, own) for part in group]
            for message in heapq.merge(*streams, key=lambda message: message.log_time_ns):
                read[message.topic] += 1
                yield message
        for topic in sorted(topics & self.stated.keys()) if extent is EVERYTHING else ():
            if read[topic] < self.stated[topic]:
                self.note(
                    f"{topic}: metadata.yaml states {self.stated[topic]} messages, {read[topic]} {COUNTED}"
                )

    def _part(self, part: Storage, topics: frozenset[str], extent: Extent) -> Iterator[Message]:
        with boundary(part.path):
            yield from part.messages(topics, extent)


def _overlapping(parts: Sequence[Storage]) -> Iterator[list[Storage]]:
    """Parts in order of time, grouped by overlap; parts without a known time form their own group."""
    group: list[Storage] = []
    end_ns = -1
    for part in parts:
        if group and (part.start_ns is None or part.start_ns > end_ns):
            yield group
            group = []
        group.append(part)
        end_ns = max(end_ns, part.end_ns if part.end_ns is not None else -1)
    if group:
        yield group
