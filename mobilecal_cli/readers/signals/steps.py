"""Clock steps: a recording is cut where the stamps jump against the log times, in all topics at once.

Within a piece every clock runs evenly, so readings and images belong together. If only some clocks step, their stamps
after the step are moved back onto the clock that they had before, by the size of the step against the log times.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.steps import LEAST_STEP_NS, steps_of
from mobilecal_cli.readers.signals.series import Samples

_NS = 1_000_000_000
#: A pause of all topics is this many times their usual interval.
_LONG_PAUSE = 10
#: Messages on each side that give its size.
_MEASURED = 101
#: Clocks that step within this time, step together; those that step by this much less or more, by the same amount.
_TOGETHER_NS, _SAME_NS = 2 * _NS, _NS // 2

#: The samples of one piece, in the order of all series.
Piece = tuple[Samples, ...]


def cut(series: Sequence[Samples]) -> tuple[list[Piece], list[str]]:
    """The pieces of a recording in order of time, and a note for each place where it is cut.

    Args:
        series: everything that is read, each with increasing log times.
    """
    steps = [steps_of(one.stamp_ns, one.log_ns) for one in series]
    starts = [[0] for _ in series]
    shifts = [[0] for _ in series]
    notes = []
    for group in _together(series, steps):
        at_ns = min(int(series[k].log_ns[index]) for k, index in group.items())
        begins = [group.get(k, int(np.searchsorted(one.log_ns, at_ns))) for k, one in enumerate(series)]
        sizes = [_size(one, starts[k][-1], begins[k]) for k, one in enumerate(series)]
        known = [size for size in sizes if size is not None]
        alike = bool(known) and max(known) - min(known) < _SAME_NS
        for k, (begin, size) in enumerate(zip(begins, sizes, strict=True)):
            starts[k].append(max(begin, starts[k][-1]))
            shifts[k].append(shifts[k][-1] + (0 if alike or size is None else _common(size, known)))
        notes.append(_note(series, group, [_common(size, known) for size in sizes if size]))
    ends = [[*begins[1:], len(one)] for begins, one in zip(starts, series, strict=True)]
    return [
        tuple(one.part(starts[k][p], ends[k][p], shifts[k][p]) for k, one in enumerate(series))
        for p in range(len(notes) + 1)
    ], notes


def pause_notes(series: Sequence[Samples]) -> list[str]:
    """A note on pauses of all topics at once, which a clock that is set forward looks like.

    Args:
        series: everything that is read, each with increasing log times.
    """
    log_ns = np.sort(np.concatenate([one.log_ns for one in series]))
    gap_ns = np.diff(log_ns)
    usual_ns = float(np.median(gap_ns)) if len(gap_ns) else 0.0
    pauses = np.flatnonzero(gap_ns > max(LEAST_STEP_NS, _LONG_PAUSE * usual_ns))
    if not len(pauses):
        return []
    worst = pauses[np.argmax(gap_ns[pauses])]
    return [
        f"{len(pauses)} pause{'s' if len(pauses) > 1 else ''} of all topics; the longest lasts "
        f"{gap_ns[worst] * 1e-9:.3f} s, {(log_ns[worst] - log_ns[0]) * 1e-9:.1f} s after the start: the recorder "
        "paused, or its clock was set forward"
    ]


def _together(series: Sequence[Samples], steps: Sequence[IntArray]) -> list[dict[int, int]]:
    """Steps of several series at about one time, as number of the series → index of its message."""
    every = sorted((int(series[k].log_ns[i]), k, int(i)) for k, found in enumerate(steps) for i in found)
    groups: list[dict[int, int]] = []
    last_ns = 0
    for log_ns, k, index in every:
        if not groups or k in groups[-1] or log_ns - last_ns > _TOGETHER_NS:
            groups.append({})
        groups[-1][k] = index
        last_ns = log_ns
    return groups


def _size(one: Samples, start: int, begin: int) -> int | None:
    """Change of the lag at the begin of a piece, ns; 0 if it is no step, None without messages on one side.

    Args:
        one: a series.
        start, begin: first index of the piece before, and of the piece.
    """
    lag = one.log_ns - one.stamp_ns
    before, after = lag[max(begin - _MEASURED, start) : begin], lag[begin : begin + _MEASURED]
    if not len(before) or not len(after):
        return None
    size = int(np.median(after)) - int(np.median(before))
    return size if abs(size) > LEAST_STEP_NS else 0


def _common(size: int, known: Sequence[int]) -> int:
    """The step of one series as that of all which step by the same amount: their stamps stay as they are together."""
    return int(np.median([other for other in known if abs(other - size) < _SAME_NS]))


def _note(series: Sequence[Samples], group: dict[int, int], sizes: Sequence[int]) -> str:
    first = min(int(one.log_ns[0]) for one in series if len(one))
    at_s = (min(int(series[k].log_ns[index]) for k, index in group.items()) - first) * 1e-9
    names = ", ".join(dict.fromkeys(series[k].topic for k in sorted(group)))
    largest = max(sizes, key=abs, default=0) * 1e-9
    way = "back" if largest > 0 else "forward"
    return (
        f"the clock of {names} steps {way} by {abs(largest):.3f} s, {at_s:.1f} s after the start; the recording is cut "
        "there, into separate logs"
    )
