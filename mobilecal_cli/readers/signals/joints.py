"""Joints that are read from a topic of joint states."""

from __future__ import annotations

from collections.abc import Sequence

from mobilecal_cli.readers.messages.joint_state import JointReading
from mobilecal_cli.readers.signals.series import Series

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
        self._places: list[tuple[int, Series, bool]] = []

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
            wanted = [(self.position, "position"), (self.velocity, "velocity")]
            self._places = [
                (names.index(name), series, field == "position")
                for kind, field in wanted
                for name, series in kind.items()
                if name in names
            ]
        for place, series, is_position in self._places:
            values = reading.position if is_position else reading.velocity
            if place < len(values):
                series.add(stamp_ns, log_ns, float(values[place]))
