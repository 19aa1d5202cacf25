"""Joints on JointState topics, read one message or many messages at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from mobilecal_cli.model import FloatArray, IntArray
from mobilecal_cli.readers.channels import Channel, Payload
from mobilecal_cli.readers.layouts import Layout, Rows, gathered, layout_of
from mobilecal_cli.readers.series import Series
from mobilecal_cli.readers.stamps import Clock

#: Limits of a batch, in messages and bytes, for any length of the recording.
BATCH_MESSAGES = 4096
BATCH_BYTES = 2**22
#: Shorter runs of messages with known layouts are read one by one, which is faster.
_SHORTEST_RUN = 8
#: Limits per topic: drivers that share it have one layout each; if the layout keeps changing, it is read one by one.
_MOST_LAYOUTS, _MOST_TRIES = 8, 64


class JointStates:
    """Positions and velocities of named joints on one JointState topic.

    Attributes:
        position, velocity: name → readings, of the subscribed joints.
        present: all names found, in order.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.position: dict[str, Series] = {}
        self.velocity: dict[str, Series] = {}
        self.present: dict[str, None] = {}
        self._names: list[str] = []
        self._places: list[tuple[int, Series, Series]] = []

    def want(self, name: str) -> None:
        """Subscribe to a joint."""
        self.position.setdefault(name, Series(f"joint {name} on {self.topic}"))
        self.velocity.setdefault(name, Series(f"velocity of joint {name} on {self.topic}"))

    def take(self, message: Any, time_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one JointState message; the order of names may change from message to message."""
        if message.name != self._names:
            self._names = list(message.name)
            self.present.update(dict.fromkeys(self._names))
            self._places = [
                (self._names.index(name), self.position[name], self.velocity[name])
                for name in self.position
                if name in self._names
            ]
        positions, velocities = (getattr(message, name, ()) for name in ("position", "velocity"))
        for place, position, velocity in self._places:
            if place < len(positions):
                position.add(time_ns, float(positions[place]))
            if place < len(velocities):
                velocity.add(time_ns, float(velocities[place]))


@dataclass(frozen=True, slots=True, eq=False)
class _Alike:
    """Messages of a batch with the same layout.

    Attributes:
        layout: their layout.
        index: (n,) increasing positions in the batch.
        rows: (n, size) payloads.
    """

    layout: Layout
    index: IntArray
    rows: Rows

    def within(self, begin: int, end: int) -> _Alike:
        """Messages between two positions in the batch."""
        low, high = np.searchsorted(self.index, [begin, end])
        return _Alike(self.layout, self.index[low:high] - begin, self.rows[low:high])


class Columns:
    """Reads a JointState topic in batches, with the same result as message by message.

    Messages with a known layout are read as columns of numbers. Others (damaged ones, or with another encoding) are
    read one by one, in order.

    Args:
        joints: receives the readings.
        clock: receives statistics of the stamps.
        one_by_one: reads a message without a known layout.
    """

    def __init__(
        self, joints: JointStates, clock: Clock, one_by_one: Callable[[Channel, int, Payload], None]
    ) -> None:
        self._joints, self._clock, self._one_by_one = joints, clock, one_by_one
        self._batch: list[tuple[Channel, int, bytes]] = []
        self._bytes = 0
        self._layouts: list[Layout] = []
        self._tries = 0

    def add(self, channel: Channel, log_ns: int, payload: Payload) -> None:
        """Add a message to the batch."""
        if len(payload) > BATCH_BYTES:
            self.read()
            self._one_by_one(channel, log_ns, payload)
            return
        # A copy: a view would keep its whole block in memory, images included.
        self._batch.append((channel, log_ns, bytes(payload)))
        self._bytes += len(payload)
        if len(self._batch) >= BATCH_MESSAGES or self._bytes >= BATCH_BYTES:
            self.read()

    def read(self) -> None:
        """Read the batch."""
        batch, self._batch, self._bytes = self._batch, [], 0
        alike = self._sorted(batch)
        known = np.zeros(len(batch), dtype=np.bool_)
        for group in alike:
            known[group.index] = True
        begin = 0
        for is_known, run in groupby(known.tolist()):
            end = begin + sum(1 for _ in run)
            if is_known and end - begin >= _SHORTEST_RUN:
                log_ns = np.array([log_ns for _, log_ns, _ in batch[begin:end]], dtype=np.int64)
                self._read(log_ns, [group.within(begin, end) for group in alike])
            else:
                for message in batch[begin:end]:
                    self._one_by_one(*message)
            begin = end

    def _sorted(self, batch: list[tuple[Channel, int, bytes]]) -> list[_Alike]:
        """Messages of a batch by layout; messages without a layout are in no group."""
        places: dict[tuple[str, str, int], list[int]] = {}
        for place, (channel, _, payload) in enumerate(batch):
            places.setdefault((channel.type, channel.encoding, len(payload)), []).append(place)
        alike = []
        for kind, listed in places.items():
            index: IntArray = np.array(listed)
            rows = gathered([batch[place][2] for place in listed])
            candidates = iter([layout for layout in self._layouts if layout.kind == kind])
            while len(index):
                layout = next(candidates, None) or self._learnt(*batch[index[0]])
                if layout is None:
                    index, rows = index[1:], rows[1:]
                    continue
                fits = layout.fits(rows)
                alike.append(_Alike(layout, index[fits], rows[fits]))
                index, rows = index[~fits], rows[~fits]
        return alike

    def _learnt(self, channel: Channel, _: int, payload: bytes) -> Layout | None:
        """Layout of a message that matches no known one, stored; None if there is none or no more are stored."""
        if len(self._layouts) == _MOST_LAYOUTS or self._tries == _MOST_TRIES:
            return None
        self._tries += 1
        layout = layout_of(channel, payload)
        if layout is not None:
            self._layouts.append(layout)
        return layout

    def _read(self, log_ns: IntArray, alike: list[_Alike]) -> None:
        """Read a run of messages with known layouts.

        Args:
            log_ns: (n,) log times.
            alike: the same messages by layout.
        """
        joints = self._joints
        alike = sorted((group for group in alike if len(group.index)), key=lambda group: int(group.index[0]))
        time_ns, unstamped = np.zeros_like(log_ns), np.zeros(len(log_ns), dtype=np.bool_)
        for group in alike:
            joints.present.update(dict.fromkeys(group.layout.names))
            seconds, nanoseconds = group.layout.stamps(group.rows)
            time_ns[group.index] = seconds * 10**9 + nanoseconds
            unstamped[group.index] = (seconds == 0) & (nanoseconds == 0)
        time_ns = np.where(time_ns == 0, log_ns, time_ns)
        self._clock.count(time_ns, unstamped, log_ns)
        for field, wanted in (("position", joints.position), ("velocity", joints.velocity)):
            for name, series in wanted.items():
                _extend(series, time_ns, field, name, alike)


def _extend(series: Series, time_ns: IntArray, field: str, name: str, alike: list[_Alike]) -> None:
    """Append a joint's readings of one field, from all layouts that have it, in message order."""
    index: list[IntArray] = []
    values: list[FloatArray] = []
    for group in alike:
        names = group.layout.names
        column = group.layout.column(group.rows, field, names.index(name)) if name in names else None
        if column is not None:
            index.append(group.index)
            values.append(column)
    if not index:
        return
    places, readings = np.concatenate(index), np.concatenate(values)
    order = np.argsort(places)
    series.extend(time_ns[places[order]], readings[order])
