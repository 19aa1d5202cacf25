"""Clocks: statistics of the stamps, and the treatment of faulty ones."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.model import BoolArray, IntArray

#: Two topics whose lags between stamp and log time differ by more use different clocks.
CLOCKS_DIFFER_S = 1.0
#: Lags stored per topic, enough for a median.
_LAGS = 101


@dataclass(slots=True)
class Clock:
    """Statistics of the stamps of one topic.

    Attributes:
        topic: the topic.
        messages, unstamped: number of messages, and of those without a header or with a zero stamp.
        has_header: whether the type has a header stamp.
        lag_s: log time minus stamp of the first few stamped messages.
    """

    topic: str
    messages: int = 0
    unstamped: int = 0
    has_header: bool = True
    lag_s: list[float] = field(default_factory=list)

    def count(self, stamp_ns: int | None, log_ns: int) -> int:
        """Count a message with a header stamp (None: without a header); returns its stamp, or the log time."""
        self.messages += 1
        self.has_header = stamp_ns is not None
        if not stamp_ns:
            self.unstamped += 1
            return log_ns
        if len(self.lag_s) < _LAGS:
            self.lag_s.append((log_ns - stamp_ns) * 1e-9)
        return stamp_ns

    def notes(self) -> list[str]:
        """Sentences on missing and zero stamps."""
        if not self.unstamped:
            return []
        if not self.has_header:
            return [f"{self.topic}: messages have no header stamp; the log time is used"]
        if self.unstamped == self.messages:
            return [f"{self.topic}: all {self.messages} header stamps are zero; the log time is used"]
        return [
            f"{self.topic}: {self.unstamped} of {self.messages} header stamps are zero; "
            "the log time is used for those"
        ]


def clock_notes(clocks: list[Clock]) -> list[str]:
    """Notes of all topics, and on topics with stamps from different clocks."""
    notes = [note for clock in clocks for note in clock.notes()]
    # A topic without stamps uses the log time, so its lag is zero.
    lags = {clock.topic: float(np.median(clock.lag_s or [0.0])) for clock in clocks if clock.messages}
    if len(lags) > 1:
        low, high = min(lags, key=lags.__getitem__), max(lags, key=lags.__getitem__)
        if lags[high] - lags[low] > CLOCKS_DIFFER_S:
            notes.append(
                f"clocks differ: the stamps of {high} are {lags[high]:.3f} s before the log time, those of "
                f"{low} {lags[low]:.3f} s"
            )
    return notes


def in_order(time_ns: IntArray) -> tuple[BoolArray, int, int, float]:
    """Which samples make time strictly increase.

    Of equal stamps the first is kept. Where a clock steps back, the longest increasing run is kept and the rest is
    dropped. A single stray stamp costs one sample. After a step back, samples at times already covered are dropped, so
    two stretches of time are never mixed.

    Args:
        time_ns: (n,) in order of arrival.

    Returns:
        (n,) True to keep; number of duplicates; number dropped for order; largest step back, s.
    """
    steps = np.diff(time_ns)
    keep = np.ones(len(time_ns), dtype=np.bool_)
    if np.all(steps > 0):
        return keep, 0, 0, 0.0
    _, first = np.unique(time_ns, return_index=True)
    keep[:] = False
    keep[first] = True
    candidates = np.flatnonzero(keep)
    if np.any(np.diff(time_ns[candidates]) < 0):
        keep[:] = False
        keep[candidates[_longest_increasing(time_ns[candidates])]] = True
    duplicates = len(time_ns) - len(first)
    return keep, duplicates, len(first) - int(keep.sum()), float(max(-int(steps.min()), 0) * 1e-9)


def _longest_increasing(values: IntArray) -> IntArray:
    """Indices of the longest strictly increasing subsequence (patience sorting)."""
    tails: list[int] = []
    ends: list[int] = []
    before = np.full(len(values), -1, dtype=np.int64)
    for index, value in enumerate(values.tolist()):
        place = bisect_left(tails, value)
        before[index] = ends[place - 1] if place else -1
        if place == len(tails):
            tails.append(value)
            ends.append(index)
        else:
            tails[place] = value
            ends[place] = index
    chain = []
    index = ends[-1] if ends else -1
    while index >= 0:
        chain.append(index)
        index = int(before[index])
    return np.array(chain[::-1], dtype=np.int64)
