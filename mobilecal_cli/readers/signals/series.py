"""Readings over time, put in order after the pass; clocks that are wrong, and where they step."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.signals import CLOCK_SET, CLOCK_STEPS, CLOCKS_DIFFER, Track
from mobilecal_cli.readers.containers.storage import LEAST_BACK_NS, LEAST_STEP_NS, steps_of


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Readings of one quantity, in order of arrival.

    Attributes:
        topic: where they come from.
        label: name for messages.
        stamp_ns, log_ns: (n,) stamps, and log times.
        value: (n, width) readings, finite.
        shift_ns: what the time of a reading is later than its stamp, because its clock stepped.
        positions: of a joint or wheel, rad or m.
    """

    topic: str
    label: str
    stamp_ns: IntArray
    log_ns: IntArray
    value: FloatArray
    shift_ns: int = 0
    positions: bool = False

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def time_ns(self) -> IntArray:
        """(n,) times of the readings."""
        return self.stamp_ns + self.shift_ns

    @property
    def messages(self) -> list[tuple[int, int]]:
        """Log time and stamp of each reading, which together identify its message."""
        return list(zip(self.log_ns.tolist(), self.stamp_ns.tolist(), strict=True))

    def rows(self, which: slice | IntArray, shift_ns: int) -> Samples:
        """Some of the readings, with another shift."""
        stamp_ns, log_ns, value = self.stamp_ns[which], self.log_ns[which], self.value[which]
        return replace(self, stamp_ns=stamp_ns, log_ns=log_ns, value=value, shift_ns=shift_ns)

    def arranged(self, notes: list[str]) -> Samples:
        """In order of their stamps, if they only arrived late; notes how many. Otherwise, as they are."""
        if not came_late(self.stamp_ns, self.log_ns):
            return self
        behind_ns = np.maximum.accumulate(self.stamp_ns) - self.stamp_ns
        notes.append(
            f"{self.topic}: {np.count_nonzero(behind_ns)} of {len(self)} samples are recorded after later ones, by "
            f"up to {float(behind_ns.max()) * 1e-9:.3f} s; they are put in order of their stamps"
        )
        return self.rows(np.argsort(self.stamp_ns, kind="stable"), self.shift_ns)

    def kept(self, notes: list[str]) -> BoolArray:
        """`in_order` of the stamps; notes what is dropped."""
        keep, total, different = in_order(self.stamp_ns), len(self), len(np.unique(self.stamp_ns))
        if different < total:
            notes.append(
                f"{self.topic}: {total - different} of {total} stamps occur twice; the first is kept"
            )
        if dropped := different - int(keep.sum()):
            back_s = -float(np.diff(self.stamp_ns).min()) * 1e-9
            notes.append(
                f"{self.topic}: {CLOCK_STEPS} {back_s:.3f} s; {dropped} of {total} samples "
                "are out of order and dropped"
            )
        return keep

    def ordered(self, notes: list[str]) -> tuple[IntArray, FloatArray]:
        """Strictly increasing times (n,), and values (n, width); notes what is dropped.

        Raises:
            RecordingError: there are none.
        """
        if not len(self):
            raise RecordingError(f"{self.label}: no readings", "record the topic during the whole recording")
        keep = self.kept(notes)
        keep[keep] = ~_overtaken(self.time_ns[keep])
        return self.time_ns[keep], self.value[keep]


#: Readings that are nearer to the next one than this share of the usual interval come together with it.
_TOGETHER = 1 / 20
#: A pause is a rest if it lasts so long, so many times as long as usual, and the reading after it differs by at most so
#: many times as much as two readings beside it.
_LEAST_REST_NS, _REST_INTERVALS, _STARTS = 500_000_000, 3, 1.5


def _overtaken(time_ns: IntArray) -> BoolArray:
    """(n,) which readings come together with a later one, as from a queue: their times say nothing.

    The usual interval is that in the middle of the time, without rests.
    """
    interval_ns = np.diff(time_ns)
    longest_ns = np.sort(interval_ns[interval_ns < _LEAST_REST_NS])[::-1]
    up_to_ns = np.cumsum(longest_ns)
    usual_ns = longest_ns[np.searchsorted(up_to_ns, up_to_ns[-1] / 2)] if len(up_to_ns) else 0
    return np.append(interval_ns < _TOGETHER * usual_ns, False)


def with_rests(track: Track) -> Track:
    """A track with readings in each rest, also of a driver that publishes none there."""
    interval_ns, way = np.diff(track.time_ns), np.abs(np.diff(track.value))
    usual_ns = int(np.median(interval_ns)) if len(way) else 0
    if not 0 < usual_ns < _LEAST_REST_NS:
        return track
    beside = np.maximum(*(np.pad(way, 1)[k : k + len(way)] for k in (0, 2)))
    pauses = interval_ns > max(_LEAST_REST_NS, _REST_INTERVALS * usual_ns)
    rests = np.flatnonzero(pauses & (way < _STARTS * beside))
    inside = [
        np.arange(end - usual_ns, begin, -usual_ns) for begin, end in track.time_ns[rests[:, None] + [0, 1]]
    ]
    time_ns = np.unique(np.concatenate([track.time_ns, *inside]))
    return Track(time_ns, track.value[np.searchsorted(track.time_ns, time_ns, side="right") - 1])


#: Readings that jump to a value and return to the one before, as two publishers of one joint give: a jump of more than
#: this, rad or m, and than this share of the range of all or so many usual steps, is so many times as large as what
#: remains of it, and faster than joints move, rad/s or m/s.
_JUMP, _JUMP_SHARE, _JUMP_STEPS, _RETURNS, _TOO_FAST = 0.03, 0.05, 10.0, 20.0, 5.0
#: Largest share of such messages among which the right readings are known; where most of them jump to one value, as of
#: a publisher that never moves anything; and fewest messages that are judged by it.
_ALTERNATING_SHARE, _ONE_VALUE_SHARE, _ALTERNATING = 0.1, 0.4, 20
#: Where a clock steps back, readings before and after it lie in one another in one stretch, at most this share of all.
_ONE_STRETCH = 0.5
_PUBLISHERS = "often joint_state_publisher beside the driver; `ros2 topic info -v` lists them"


def _strays(value: FloatArray, log_ns: IntArray) -> IntArray:
    """Indices of single readings (n,), rad or m, that jump away from those beside them, as no joint or wheel moves.

    An angle that is wrapped to one turn may jump by a turn.
    """
    if len(value) < 3:
        return np.zeros(0, dtype=np.int64)
    steps, spread = np.abs(np.diff(value)), float(np.ptp(value))
    back = np.abs(value[2:] - value[:-2])
    if spread < 2 * np.pi + _JUMP:
        steps, back = (np.minimum(each, np.abs(2 * np.pi - each)) for each in (steps, back))
    usual = float(np.median(steps[steps > 0])) if np.any(steps) else 0.0
    reach = _TOO_FAST * 1e-9 * np.abs(log_ns[2:] - log_ns[:-2]) / 2
    least = max(_JUMP, min(_JUMP_SHARE * spread, _JUMP_STEPS * usual))
    jump = np.minimum(steps[1:], steps[:-1])
    return 1 + np.flatnonzero(jump > np.maximum(np.maximum(_RETURNS * back, reach), least))


def without_strays(every: Sequence[Samples], notes: list[str]) -> list[Samples]:
    """Readings without messages in which a position jumps to another value and back; notes how many.

    A message that is wrong for one joint is another publisher's, and is dropped for all joints on its topic.

    Raises:
        RecordingError: they are many.
    """
    wrong: dict[str, set[tuple[int, int]]] = {}  # topic → log time and stamp of messages
    example: dict[str, str] = {}
    for samples in (samples for samples in every if samples.positions):
        value, total = samples.value[:, 0], len(samples)
        strays = _strays(value, samples.log_ns)
        if not len(strays):
            continue
        each, counts = np.unique(value[strays], return_counts=True)
        most, limit = strays[value[strays] == each[np.argmax(counts)]], _ALTERNATING_SHARE
        if len(most) > max(len(strays) / 2, limit * total):  # those beside them may seem to jump, too
            strays, limit = most, _ONE_VALUE_SHARE
        before, k = strays[len(strays) // 2] + np.array([-1, 0])
        if total >= _ALTERNATING and len(strays) > limit * total:
            alternate = (
                f"{samples.label}: the readings alternate between two values, such as {value[before]:.3g} and "
                f"{value[k]:.3g}, in {100 * len(strays) / total:.0f} % of {total} messages (limit "
                f"{100 * limit:.0f} %)"
            )
            first_s, last_s = (1e-9 * (samples.log_ns[strays[[0, -1]]] - samples.log_ns[0])).tolist()
            if last_s - first_s < _ONE_STRETCH * 1e-9 * np.ptp(samples.log_ns):
                raise RecordingError(
                    f"{alternate}, all within {last_s - first_s:.1f} s from {first_s:.1f} s on: the clock of the topic "
                    "steps back by as much there, or a second publisher runs for so long",
                    f"keep the clock from stepping (chrony slews it), stop a second publisher ({_PUBLISHERS}), and "
                    "record again",
                )
            raise RecordingError(
                f"{alternate}: two publishers share the topic",
                f"stop the other one ({_PUBLISHERS}), and record again",
            )
        wrong.setdefault(samples.topic, set()).update(samples.rows(strays, 0).messages)
        name = samples.label.removesuffix(f" on {samples.topic}")
        example[samples.topic] = f"{name} from {value[before]:.3g} to {value[k]:.3g}"
    kept = list(every)
    for number, samples in enumerate(every):
        if samples.topic in wrong:
            right = [message not in wrong[samples.topic] for message in samples.messages]
            kept[number] = samples.rows(np.flatnonzero(right), samples.shift_ns)
    notes += (
        f"{topic}: in {len(messages)} messages, readings jump to another value and back, such as {example[topic]}; "
        f"these messages are dropped; if a second publisher shares the topic, stop it ({_PUBLISHERS})"
        for topic, messages in wrong.items()
    )
    return kept


#: No joint and no wheel rests for so short a time, s. After longer ones it did not rest if there are so many equal
#: readings or more, for so many times the intervals between the readings beside them, and if the step after them is so
#: many times what the motion beside it would make since the last reading.
_NO_REST_S, _EQUAL, _LONGER, _LEAP = 0.25, 5, 4.0, 3.0
#: A step catches up if it is at most so many times as large as the motion beside it would make since the last fresh
#: reading; and so many times as large as the smallest ones, of which this is the share: those of an encoder.
_CATCHES_UP, _STEPS, _SMALLEST = 3.0, 5.0, 0.01
#: A driver repeats each reading if so many of such large steps catch up, and more than this share of them.
_SEVERAL, _ALWAYS = 10, 0.5


def without_stale(label: str, track: Track, notes: list[str]) -> Track:
    """A track without readings that a driver repeated while the joint or the wheel went on; notes how many.

    Where it repeats each reading, as by a publisher that is faster than the encoder, slow motions do not show that.
    There, and at rest, one reading of as many is kept.
    """
    fresh = np.append(0, np.flatnonzero(np.diff(track.value)) + 1)
    if len(fresh) < 7:
        return track
    stale, large = _catching_up(1e-9 * (track.time_ns - track.time_ns[0]), track.value, fresh)
    if not stale.any():
        return track
    keep, numbers = np.ones(len(track.value), dtype=np.bool_), np.arange(len(track.value))
    first = fresh[np.searchsorted(fresh, numbers, side="right") - 1]
    if stale.sum() >= _SEVERAL and np.mean(stale[large]) > _ALWAYS:
        keep = (numbers - first) % int(np.median(np.diff(fresh)[stale])) == 0
    keep &= (numbers == first) | ~np.isin(first, fresh[:-1][stale])
    longest_s = 1e-9 * np.diff(track.time_ns[fresh])[stale].max()
    notes.append(
        f"{label}: {int(np.sum(~keep))} of {len(keep)} readings repeat an old value, for up to {longest_s:.2f} s "
        "during a motion; dropped"
    )
    return Track(track.time_ns[keep], track.value[keep])


def _catching_up(time_s: FloatArray, value: FloatArray, fresh: IntArray) -> tuple[BoolArray, BoolArray]:
    """Which steps between fresh readings, those that differ from the one before, catch up after repeated ones.

    After a short time, such a step is nearer to what the motion before and after, in the same direction, would make
    since the last fresh reading than to what it would make since the last reading. After a long time, it is many times
    the latter. What stood still starts slowly.

    Args:
        time_s, value: (n,) readings.
        fresh: (k + 1,) indices of the fresh ones.

    Returns:
        (k,) steps that catch up, and (k,) all that are as large.
    """
    at_s, change = time_s[fresh], np.diff(value[fresh])
    step, since_s, last_s = np.abs(change), np.diff(at_s), at_s[1:] - time_s[fresh[1:] - 1]
    large = step > _STEPS * np.quantile(step, _SMALLEST)
    inner = 2 + np.flatnonzero(np.diff(fresh)[2:-2] > 1)
    beside = np.stack([inner - 2, inner - 1, inner + 1, inner + 2])
    speed = np.maximum(
        *(step[pair].sum(axis=0) / since_s[pair].sum(axis=0) for pair in (beside[:2], beside[2:]))
    )
    repeats, since, size = np.diff(fresh)[inner], since_s[inner], step[inner]
    last = np.maximum(last_s[inner], since / repeats)  # messages may arrive together
    one_way = np.all(np.sign(change[beside]) == np.sign(change[inner]), axis=0)
    short = one_way & (since < _NO_REST_S) & (size > speed * (since + last) / 2)
    long = (
        (repeats > _EQUAL) & (since > _LONGER * since_s[beside].max(axis=0)) & (size > _LEAP * speed * last)
    )
    found = np.zeros(len(step), dtype=np.bool_)
    found[inner] = (short | long) & (size < _CATCHES_UP * speed * since) & large[inner]
    return found, large


_NS = 1_000_000_000
#: Lags of two topics that differ by more are noted, s: images that are compressed may be recorded so late.
_CLOCKS_APART_S = 0.3
#: Lags stored per topic: of its first messages, before a clock steps.
LAGS = 11


@dataclass(slots=True)
class Clock:
    """Statistics of the stamps of one topic.

    Attributes:
        topic: the topic.
        messages, unstamped: number of messages, and of those without a header or with a zero stamp.
        broken: number of messages that do not match their type, beside the others.
        has_header: whether the type has a header stamp.
        lag_s: log time minus stamp of the first few stamped messages.
    """

    topic: str
    messages: int = 0
    unstamped: int = 0
    broken: int = 0
    has_header: bool = True
    lag_s: list[float] = field(default_factory=list)

    def count(self, stamp_ns: int | None, log_ns: int) -> None:
        """Count a message with a header stamp; None: without a header."""
        self.messages += 1
        self.has_header = stamp_ns is not None
        if not stamp_ns:
            self.unstamped += 1
        elif len(self.lag_s) < LAGS:
            self.lag_s.append((log_ns - stamp_ns) * 1e-9)


def clock_notes(clocks: Collection[Clock]) -> list[str]:
    """Notes on missing and zero stamps, on stamps from different clocks, and on messages that are not used."""
    notes = []
    for clock in (clock for clock in clocks if clock.unstamped):
        fact = f"{clock.unstamped} of {clock.messages} header stamps are zero; the log time is used for those"
        if not clock.has_header:
            fact = "messages have no header stamp; the log time is used"
        elif clock.unstamped == clock.messages:
            fact = f"all {clock.messages} header stamps are zero; the log time is used"
        notes.append(f"{clock.topic}: {fact}")
    # A topic without stamps uses the log time, so its lag is zero. What is published once may be older.
    lags = {clock.topic: float(np.median(clock.lag_s or [0.0])) for clock in clocks if clock.messages > 1}
    if len(lags) > 1:
        low, high = min(lags, key=lags.__getitem__), max(lags, key=lags.__getitem__)
        if lags[high] - lags[low] > _CLOCKS_APART_S:
            first, other = (
                f"{abs(lags[topic]):.3f} s {'before' if lags[topic] >= 0 else 'after'}"
                for topic in (high, low)
            )
            notes.append(
                f"{CLOCKS_DIFFER}: the stamps of {high} are {first} the log time, those of {low} {other} it"
            )
    notes += (
        f"{clock.topic}: {clock.broken} of {clock.broken + clock.messages} messages do not match their type; ignored"
        for clock in clocks
        if clock.broken
    )
    return notes


#: Stamps are not of the future by more than this, or than so many times the usual lateness of others.
_AHEAD_NS, _AHEAD = _NS // 10, 3.0
#: In order of their stamps, samples are not nearer to each other than this share of their usual interval.
_CROWDED, _USUAL_INTERVAL = 0.75, 0.05


def came_late(stamp_ns: IntArray, log_ns: IntArray) -> bool:
    """Whether samples out of order have right stamps, and only their recording was late.

    A sample that comes late has a larger lag between stamp and log time than others before and after it, and it fills
    a gap between the others. After a step of the clock, the lags of all samples differ from those before, and two
    stretches of time lie in one another.

    Args:
        stamp_ns, log_ns: (n,) stamps and log times, in order of arrival.
    """
    steps = np.diff(stamp_ns)
    if np.all(steps >= 0):
        return False
    lag = log_ns - stamp_ns
    low, median, high = (float(value) for value in np.quantile(lag, [0.0, 0.5, 0.9]))
    before, after = np.maximum.accumulate(lag)[:-1], np.minimum.accumulate(lag[::-1])[::-1][1:]
    stepped = bool(np.any((steps < 0) & (before < after)))
    usual_ns = float(np.quantile(np.abs(steps[steps != 0]), _USUAL_INTERVAL))
    sorted_ns = np.diff(np.unique(stamp_ns))
    return (
        not stepped
        and median - low <= _AHEAD_NS + _AHEAD * (high - median)
        and float(sorted_ns.min()) >= _CROWDED * usual_ns
    )


def in_order(time_ns: IntArray) -> BoolArray:
    """Which samples make time strictly increase, (n,).

    Of equal stamps the first is kept. Where a clock steps back, the longest increasing run is kept and the rest is
    dropped. A single stray stamp costs one sample. After a step back, samples at times already covered are dropped, so
    two stretches of time are never mixed.

    Args:
        time_ns: (n,) in order of arrival.
    """
    _, first = np.unique(time_ns, return_index=True)
    first.sort()
    keep = np.zeros(len(time_ns), dtype=np.bool_)
    keep[first[_longest_increasing(time_ns[first])]] = True
    return keep


def _longest_increasing(values: IntArray) -> IntArray:
    """Indices of the longest strictly increasing subsequence (patience sorting)."""
    if np.all(np.diff(values) > 0):
        return np.arange(len(values))
    tails: list[int] = []  # of the runs of each length, the smallest last value, and its index
    ends: list[int] = []
    before: list[int] = []
    for index, value in enumerate(values.tolist()):
        place = bisect_left(tails, value)
        before.append(ends[place - 1] if place else -1)
        tails[place : place + 1] = [value]
        ends[place : place + 1] = [index]
    chain = []
    index = ends[-1]
    while index >= 0:
        chain.append(index)
        index = before[index]
    return np.array(chain[::-1], dtype=np.int64)


#: A pause of all topics is this many times their usual interval.
_LONG_PAUSE = 10
#: Messages on each side that give its size.
_MEASURED = 101
#: Clocks that step within this time, step together; those that step by this much less or more, or by half of the
#: smallest step, by the same amount.
_TOGETHER_NS, _SAME_NS = 2 * LEAST_STEP_NS, LEAST_STEP_NS // 2


def cut(series: Sequence[Samples]) -> tuple[list[tuple[Samples, ...]], list[str]]:
    """The pieces of a recording in order of time, each of all series, and a note for each place where it is cut.

    Args:
        series: everything that is read, each with increasing log times.
    """
    groups, size_ns = _together(series, [steps_of(s.stamp_ns, s.log_ns) for s in series]), 0
    if not groups:
        series, group, size_ns = _with_log_times(series)
        groups = [group] if group else []
    first_ns = min((int(samples.log_ns[0]) for samples in series if len(samples)), default=0)
    starts = [[0] for _ in series]
    shifts = [[0] for _ in series]
    notes = []
    for group in groups:
        around_ns = np.array([series[k].log_ns[[index - 1, index]] for k, index in group.items()])
        at_ns = (int(around_ns[:, 0].max()) + int(around_ns[:, 1].min())) // 2
        begins = [
            group.get(k, int(np.searchsorted(samples.log_ns, at_ns))) for k, samples in enumerate(series)
        ]
        changes = [
            size_ns if size_ns and k in group else _change(samples, starts[k][-1], begins[k])
            for k, samples in enumerate(series)
        ]
        smallest_ns = min((abs(change) for k in group if (change := changes[k])), default=0)
        same_ns = min(_SAME_NS, max(smallest_ns, LEAST_BACK_NS) // 2)
        sizes = _sizes(changes, same_ns)
        if not any(sizes):
            continue
        alike = np.ptp([size for size in sizes if size is not None] or [0]) < same_ns
        for k, (begin, size) in enumerate(zip(begins, sizes, strict=True)):
            starts[k].append(max(begin, starts[k][-1]))
            shifts[k].append(shifts[k][-1] + (0 if alike else size or 0))
        at_s = (int(around_ns[:, 1].min()) - first_ns) * 1e-9
        names = dict.fromkeys(samples.topic for samples, size in zip(series, sizes, strict=True) if size)
        largest_s = max((size or 0 for size in sizes), key=abs) * 1e-9
        notes.append(
            f"the clock of {', '.join(names)} steps {'back' if largest_s > 0 else 'forward'} by {abs(largest_s):.3f} "
            f"s, {at_s:.1f} s after the start; the recording is cut there, into separate logs"
        )
    ends = [[*begins[1:], len(samples)] for begins, samples in zip(starts, series, strict=True)]
    return [
        tuple(s.rows(slice(starts[k][p], ends[k][p]), shifts[k][p]) for k, s in enumerate(series))
        for p in range(len(notes) + 1)
    ], notes


#: Topics of at least so many messages end together up to this. Where a clock steps back, two stretches of messages lie
#: in one another: so many times as many as usual.
_FEWEST, _ENDS_NS, _CROWD = 10, 300_000_000, 1.6


def _ends_apart(series: Sequence[Samples]) -> tuple[int, list[int], list[int]]:
    """How much later than all others some topics end, ns, and numbers of these and of the other series.

    0 and none if that is less than a step, or than twice the pauses of the last ones of these others.
    """
    if len(series) < 2 or min(len(samples) for samples in series) < _FEWEST:
        return 0, [], []
    ends = np.array([samples.log_ns[-1] for samples in series])
    order, apart_ns = np.argsort(ends), np.diff(np.sort(ends))
    split, size_ns = int(np.argmax(apart_ns)) + 1, int(apart_ns.max())
    if size_ns < max(LEAST_STEP_NS, 2 * int(np.diff(series[order[split - 1]].log_ns).max())):
        return 0, [], []
    return size_ns, order[split:].tolist(), order[:split].tolist()


def _with_log_times(series: Sequence[Samples]) -> tuple[Sequence[Samples], dict[int, int], int]:
    """A step of the clock that gives the log times of some topics, too, so that the lags tell nothing.

    After a step forward, these topics have a pause that no other has, and end later than all others by as much. After
    one back, they end earlier, and two stretches of messages lie in one another.

    Returns:
        The series, without such stretches; number of each whose clock steps → index of its first message after the
        step; and size of the step back, ns. Without a step, these are empty and 0.
    """
    size_ns, late, early = _ends_apart(series)
    forward = {k: _pause(series[k].log_ns, size_ns) for k in late}
    if all(forward.values()) and not any(_pause(series[k].log_ns, size_ns) for k in early):
        return series, forward, -size_ns
    back = {k: _crowd(series[k].log_ns, size_ns) for k in early}
    if not all(last for _, last in back.values()):
        return series, {}, 0
    begin_ns = min(int(series[k].log_ns[first]) for k, (first, _) in back.items())
    end_ns = max(int(series[k].log_ns[last - 1]) for k, (_, last) in back.items())
    left = []
    for k, samples in enumerate(series):
        span = back.get(k) or np.searchsorted(samples.log_ns, [begin_ns, end_ns + size_ns])
        left.append(samples.rows(np.delete(np.arange(len(samples)), slice(*span)), 0))
    return left, {k: first for k, (first, _) in back.items()}, size_ns


def _pause(log_ns: IntArray, size_ns: int) -> int:
    """Index of the first message after the only pause that is as long as a step; 0 without one.

    Images at stops have long pauses of their own, which show no step.
    """
    gaps = np.diff(log_ns)
    usual_ns, longest_ns = np.partition(gaps, -2)[-2:].tolist()
    fits = usual_ns < _ENDS_NS and size_ns - _ENDS_NS < longest_ns < size_ns + usual_ns + _ENDS_NS
    return int(np.argmax(gaps)) + 1 if fits else 0


def _crowd(log_ns: IntArray, size_ns: int) -> tuple[int, int]:
    """Indices of the first message, and after the last, of the time of a step with the most messages; 0, 0 if usual.

    All messages are then as many more as come in the time of the step: of a topic whose rate changes, more or less.
    """
    usual_ns = float(np.median(np.diff(log_ns)))
    more = len(log_ns) - 1 - (log_ns[-1] - log_ns[0]) / usual_ns
    counts = np.searchsorted(log_ns, log_ns + size_ns + 2 * _ENDS_NS) - np.arange(len(log_ns))
    first = int(np.argmax(counts))
    crowded = counts[first] > (_CROWD * size_ns + 2 * _ENDS_NS) / usual_ns
    if not crowded or abs(more * usual_ns / size_ns - 1) > _CROWD - 1:
        return 0, 0
    return first, first + int(counts[first])


def end_notes(series: Sequence[Samples]) -> list[str]:
    """A note on topics that end later than all others and have a pause: it may be a step, but not surely."""
    size_ns, late, _ = _ends_apart(series)
    pauses_ns = [int(np.diff(series[k].log_ns).max()) for k in late]
    if _with_log_times(series)[1] or min(pauses_ns, default=0) < size_ns - _ENDS_NS or not late:
        return []
    names = ", ".join(dict.fromkeys(series[k].topic for k in late))
    return [
        f"{names}: messages come until {size_ns * 1e-9:.1f} s after the last ones of all other topics, and there is a "
        f"pause of {min(pauses_ns) * 1e-9:.1f} s: {CLOCK_SET}"
    ]


def pause_notes(series: Sequence[Samples]) -> list[str]:
    """A note on pauses of all topics at once, which a clock that is set forward looks like.

    Args:
        series: everything that is read, each with increasing log times.
    """
    log_ns = np.sort(np.concatenate([samples.log_ns for samples in series]))
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
    every = sorted(
        (int(series[k].log_ns[i]), k, int(i)) for k, backward in enumerate(steps) for i in backward
    )
    groups: list[dict[int, int]] = []
    last_ns = 0
    for log_ns, k, index in every:
        if not groups or k in groups[-1] or log_ns - last_ns > _TOGETHER_NS:
            groups.append({})
        groups[-1][k] = index
        last_ns = log_ns
    return groups


def _change(samples: Samples, start: int, begin: int) -> int | None:
    """Change of the lag from the piece from `start` on to that from `begin` on, ns; None if one has no messages."""
    lag = samples.log_ns - samples.stamp_ns
    before, after = lag[max(begin - _MEASURED, start) : begin], lag[begin : begin + _MEASURED]
    if not len(before) or not len(after):
        return None
    return int(np.median(after)) - int(np.median(before))


def _sizes(changes: Sequence[int | None], same_ns: int) -> list[int | None]:
    """The step of each series, as that of all which step by the same amount: their stamps stay as they are together.

    A smaller one of the `changes` than `same_ns` is no step, and two that differ by less are the same step.
    """
    steps = [None if change is None else change * (abs(change) >= same_ns) for change in changes]
    known = [step for step in steps if step is not None]
    return [
        None if step is None else int(np.median([other for other in known if abs(other - step) < same_ns]))
        for step in steps
    ]
