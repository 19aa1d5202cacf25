"""What all containers share: raw messages in order of log time, limits, and steps of the clocks."""

from __future__ import annotations

import bz2
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Set
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, ClassVar, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard

from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.readers.messages import ALWAYS_BYTES, LARGEST_RATIO, Channel, largest_size
from mobilecal_cli.readers.messages.types import Decoded, Payload


class Message(NamedTuple):
    """One message, not yet decoded.

    Attributes:
        channel: its channel.
        log_time_ns: time at which the recorder wrote it.
        payload: raw bytes.
    """

    channel: Channel
    log_time_ns: int
    payload: Payload

    @property
    def topic(self) -> str:
        """Topic of the message."""
        return self.channel.topic

    def decode(self) -> Decoded:
        """The message as an object with the fields of its definition; arrays are views of the payload.

        Raises:
            RecordingError: the payload does not match the definition.
        """
        return self.channel.decode(self.payload)


#: Log times after the year 2116 are damage; these and their differences fit into 64 signed bits.
LATEST_NS = 2**62
WITHOUT_TIME = "messages without a log time before the year 2116 are skipped"
#: End of a note on the number of messages.
COUNTED = "could be read"


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """Part of a recording to read.

    Attributes:
        within_bytes: if the topics need more bytes of the file than this, only stretches spread evenly over it are
            read; None: no limit.
        at_ns: (n,) increasing log times: only their messages are needed, and others may be included; None: all times.
    """

    within_bytes: int | None = None
    at_ns: IntArray | None = None


EVERYTHING = Extent()


class Storage(ABC):
    """One file of a recording.

    Attributes:
        container: format of the file, for messages.
        path: the file, as given by the user or unpacked.
        opened: the file that is read: `path`, or a complete copy of it.
        files: what is open until the end.
        channels: channel id → channel.
        counts: channel id → number of messages, stated in the file or counted.
        start_ns, end_ns: log time of the first and last message, None if unknown or empty.
        shift_ns: what the last log times are later than stored, because the recorder's clock stepped back.
        damage: data that was lost, as sentences, each once; complete after a full pass.
    """

    container: ClassVar[str]

    def __init__(self, path: Path) -> None:
        self.path = self.opened = path
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self.shift_ns = 0
        self.damage: dict[str, None] = {}
        with ExitStack() as self.files:  # which closes them if they cannot be used
            self.read()
            self.files = self.files.pop_all()

    @abstractmethod
    def read(self) -> None:
        """Open `files`, and find what they contain."""

    def close(self) -> None:
        """Close the files."""
        self.files.close()

    @property
    def topic_names(self) -> Set[str]:
        """Names of the topics."""
        return {channel.topic for channel in self.channels.values()}

    def note(self, sentence: str) -> None:
        """Add a note on damage; a repeated one counts once."""
        self.damage[f"{self.path.name}: {sentence}"] = None

    def note_share(self, whole: int) -> None:
        """Note that the file is shorter than it states, with the share of its bytes that is left."""
        size = self.path.stat().st_size
        self.note(
            f"the file is truncated: {size} of {whole} bytes or more ({100 * size / whole:.0f} %) are left"
        )

    def note_step(self, size_ns: int) -> None:
        """Note a step of the recorder's clock."""
        self.note(
            f"the recorder's clock steps back by {size_ns * 1e-9:.3f} s; messages are read in the order of the file"
        )

    def shifts_of(self, channel: IntArray, log_ns: IntArray) -> IntArray:
        """(n,) what log times are later than stored, for they go on where the clock stepped back; notes the steps.

        Args:
            channel, log_ns: see `steps_back`.
        """
        shift_ns = np.zeros_like(log_ns)
        for first, size_ns in steps_back(channel, log_ns):
            shift_ns[first:] += size_ns
            self.shift_ns += size_ns
            self.note_step(size_ns)
        return shift_ns

    def channels_of(self, topics: Collection[str]) -> set[int]:
        """Ids of the channels of some topics."""
        return {number for number, channel in self.channels.items() if channel.topic in topics}

    @abstractmethod
    def messages(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[Message]:
        """Messages of the topics in order of log time, as far as the file is intact."""

    @abstractmethod
    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        """Number of bytes that `messages` reads."""

    @abstractmethod
    def log_times(self) -> IntArray:
        """(2, n) channel ids and log times in file order; none if they are not available without reading all."""

    @abstractmethod
    def delay(self, shift_ns: int) -> None:
        """Let all log times be later."""

    def compare_counts(self, topics: Collection[str], read: Counter[int]) -> None:
        """After a full pass, note topics with fewer messages than the file states."""
        for number in sorted(self.channels_of(topics)):
            if read[number] < self.counts[number]:
                topic = self.channels[number].topic
                self.note(f"{topic}: {read[number]} of {self.counts[number]} messages {COUNTED}")


def decompress(data: bytes, method: str, size: int, *, truncated: bool = False) -> bytes:
    """Decompressed bytes of a chunk.

    Args:
        data: as stored.
        method: "", "none", "lz4", "zstd" or "bz2".
        size: length stated by the container, bytes.
        truncated: whether the end of the chunk is missing.

    Raises:
        ValueError: unknown method, or the length differs from the stated one.
    """
    if not 0 <= size <= largest_size(len(data)):
        raise ValueError(f"a chunk of {len(data)} bytes states a decompressed size of {size}")
    if method in ("", "none"):
        whole = data
    elif method == "lz4":
        whole = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif method == "bz2":
        whole = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
    elif method == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            whole = reader.read(size + 1)
    else:
        raise ValueError(f"unknown compression {method!r}")
    if len(whole) != size and not truncated:
        raise ValueError(f"a chunk states {size} bytes, but contains {len(whole)}")
    return whole


def expand(source: BinaryIO, target: Path) -> str:
    """Decompress a zstd file.

    Returns:
        "" if the file is complete, otherwise what is wrong; `target` then contains what could be decompressed.

    Raises:
        OSError: `target` cannot be written.
    """
    stored = source.seek(0, 2)
    source.seek(0)
    room = max(ALWAYS_BYTES, LARGEST_RATIO * stored)
    with target.open("wb") as sink, zstandard.ZstdDecompressor().stream_reader(source) as reader:
        while True:
            try:
                piece = reader.read(2**20)
            except zstandard.ZstdError as error:
                return str(error)
            if not piece:
                return ""
            room -= len(piece)
            if room < 0:
                return f"its {stored} bytes decompress to more than {LARGEST_RATIO} times their size"
            sink.write(piece)


#: Smallest step forward, which messages that wait in a queue look like, also in multiples of the changes of a topic's
#: lag that are not rare: a slow playback is no step. Smallest one back, which makes time run backward.
LEAST_STEP_NS = 1_000_000_000
_LEAST_RATIO, _NOT_RARE = 10, 0.9
LEAST_BACK_NS = 100_000_000
#: Messages on each side of a step whose median lag must differ by it: single wrong stamps are none.
_AROUND = 5
#: Channels with fewer messages do not tell whether the log times of all step.
_USUAL = 10


def steps_of(stamp_ns: IntArray, log_ns: IntArray) -> IntArray:
    """(k,) indices of the first messages after steps of a clock.

    A clock that steps back gives a stamp before the last one, one that steps forward a stamp that is later by much more
    than the log time. A message that comes late does neither.

    Args:
        stamp_ns, log_ns: (n,) stamps and increasing log times, in order of arrival.
    """
    if len(stamp_ns) < 2 * _AROUND:
        return np.zeros(0, dtype=np.int64)
    lag = log_ns - stamp_ns
    jump, back = np.diff(lag), np.diff(stamp_ns) <= 0
    limit = np.maximum(
        np.where(back, LEAST_BACK_NS, LEAST_STEP_NS), _LEAST_RATIO * np.quantile(np.abs(jump), _NOT_RARE)
    )
    sudden = np.where(back, jump, -jump) > limit
    middle = np.median(np.lib.stride_tricks.sliding_window_view(lag, _AROUND), axis=1)
    # Medians of the messages before and after each place that has enough of them on both sides.
    change = middle[_AROUND:] - middle[:-_AROUND]
    inside = slice(_AROUND - 1, len(jump) - _AROUND + 1)
    lasting = np.zeros(len(jump), dtype=np.bool_)
    lasting[inside] = np.abs(change) > limit[inside]
    return np.asarray(np.flatnonzero(sudden & lasting) + 1, dtype=np.int64)


def goes_back(channel: IntArray, log_ns: IntArray) -> bool:
    """Whether the log times of a channel go back by more than the smallest step back; arguments as of `steps_back`."""
    if not len(log_ns) or log_ns.min() < 0 or log_ns.max() >= LATEST_NS:
        return False  # damage
    order = np.argsort(channel, kind="stable")
    same = np.diff(channel[order]) == 0
    return bool(np.any(np.diff(log_ns[order])[same] < -LEAST_BACK_NS))


def steps_back(channel: IntArray, log_ns: IntArray) -> list[tuple[int, int]]:
    """Where the log times of a file start again at an earlier time, because the recorder's clock stepped back.

    There, a channel's log times go back for good, and so do those of most others with shorter intervals than the step:
    a file that was written topic by topic has no step.

    Args:
        channel, log_ns: (n,) ids of the channels and log times of all messages, in the order of the file.

    Returns:
        Number of the first message after each step, and its size, ns, by which the log times after it are later when
        they go on where they were.
    """
    if not goes_back(channel, log_ns):
        return []
    order = np.argsort(channel, kind="stable")
    sets = np.split(order, np.flatnonzero(np.diff(channel[order])) + 1)
    steps: list[tuple[int, int]] = []
    places = [
        (int(own[k]), int(own[k - 1]))
        for own in sets
        for k in steps_of(log_ns[own], np.zeros(len(own), dtype=np.int64))
        if log_ns[own[k]] < log_ns[own[k - 1]]
    ]
    intervals = [(own, np.median(np.abs(np.diff(log_ns[own])))) for own in sets if len(own) >= _USUAL]
    usual_ns = min((interval_ns for _, interval_ns in intervals), default=0)
    for last, first in sorted(places):
        if steps and first < steps[-1][0]:
            continue
        at = first + 1 + int(np.argmin(np.diff(log_ns[first : last + 1])))
        quick = [own for own, interval_ns in intervals if interval_ns < log_ns[first] - log_ns[last]]
        ends = [(own[k - 1], own[k]) for own in quick if 0 < (k := int(np.searchsorted(own, at))) < len(own)]
        back = [(log_ns[a], log_ns[b]) for a, b in ends if log_ns[b] <= log_ns[a]]
        if 2 * len(back) > len(quick):
            steps.append((at, int(max(a for a, _ in back) - min(b for _, b in back) + usual_ns)))
    return steps if int(log_ns.max()) + sum(size_ns for _, size_ns in steps) < LATEST_NS else []
