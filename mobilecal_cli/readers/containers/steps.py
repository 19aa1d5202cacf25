"""Steps of clocks: where stamps jump against log times, and where log times jump back in the order of a file."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.model import IntArray

#: Smallest step, also in multiples of a topic's usual change of its lag: a slow playback is no step.
LEAST_STEP_NS = 1_000_000_000
_LEAST_RATIO = 10
#: Later log times are damage, and their differences do not fit into 64 bits.
_LATEST_NS = 2**62
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
    jump = np.diff(lag)
    limit = max(LEAST_STEP_NS, _LEAST_RATIO * float(np.median(np.abs(jump))))
    sudden = np.where(np.diff(stamp_ns) <= 0, jump > limit, -jump > limit)
    middle = np.median(np.lib.stride_tricks.sliding_window_view(lag, _AROUND), axis=1)
    # Medians of the messages before and after each place that has enough of them on both sides.
    change = middle[_AROUND:] - middle[:-_AROUND]
    lasting = np.zeros(len(jump), dtype=np.bool_)
    lasting[_AROUND - 1 : len(jump) - _AROUND + 1] = np.abs(change) > limit
    return np.asarray(np.flatnonzero(sudden & lasting) + 1, dtype=np.int64)


def goes_back(channel: IntArray, log_ns: IntArray) -> bool:
    """Whether the log times of a channel go back by more than the smallest step; arguments as of `steps_back`."""
    if not len(log_ns) or log_ns.min() < 0 or log_ns.max() >= _LATEST_NS:
        return False  # damage
    order = np.argsort(channel, kind="stable")
    same = np.diff(channel[order]) == 0
    return bool(np.any(np.diff(log_ns[order])[same] < -LEAST_STEP_NS))


def steps_back(channel: IntArray, log_ns: IntArray) -> list[tuple[int, int]]:
    """Where the log times of a file start again at an earlier time, because the recorder's clock stepped back.

    There, a channel's log times go back for good, and so do those of most others: a file that was written topic by
    topic has no step.

    Args:
        channel, log_ns: (n,) ids of the channels and log times of all messages, in the order of the file.

    Returns:
        Number of the first message after each step, and its size, ns, by which the log times after it are later when
        they go on where they were.
    """
    order = np.argsort(channel, kind="stable")
    sets = np.split(order, np.flatnonzero(np.diff(channel[order])) + 1)
    steps: list[tuple[int, int]] = []
    places = [
        (int(own[k]), int(own[k - 1]))
        for own in sets
        for k in steps_of(log_ns[own], np.zeros(len(own), dtype=np.int64))
        if log_ns[own[k]] < log_ns[own[k - 1]]
    ]
    usual = [own for own in sets if len(own) >= _USUAL]
    usual_ns = min((np.median(np.abs(np.diff(log_ns[own]))) for own in usual), default=0)
    for last, first in sorted(places):
        if steps and first < steps[-1][0]:
            continue
        at = first + 1 + int(np.argmin(np.diff(log_ns[first : last + 1])))
        ends = [(own[k - 1], own[k]) for own in usual if 0 < (k := int(np.searchsorted(own, at))) < len(own)]
        back = [(log_ns[a], log_ns[b]) for a, b in ends if log_ns[b] <= log_ns[a]]
        if 2 * len(back) > len(usual):
            steps.append((at, int(max(a for a, _ in back) - min(b for _, b in back) + usual_ns)))
    return steps if int(log_ns.max()) + sum(size_ns for _, size_ns in steps) < _LATEST_NS else []
