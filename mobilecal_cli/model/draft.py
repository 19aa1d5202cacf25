"""Draft of a rig.yaml: what was filled in and from where, and what is left to the user."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NumberField:
    """A number in the messages of one topic, which may be a wheel's counter or a joint's angle.

    Attributes:
        topic, path: where it is; `path` as in rig.yaml ("data", "left.ticks").
        integer: whether it is a whole number.
        bits: width of its type, None if unknown.
        wraps: number of bits at which it was seen to start again; None if it was not.
        jump: size of the jumps where it starts again, if they fit no number of bits.
    """

    topic: str
    path: str
    integer: bool
    bits: int | None = None
    wraps: int | None = None
    jump: int | None = None


@dataclass(frozen=True, slots=True)
class Filled:
    """A setting that was filled in.

    Attributes:
        key: dotted key of rig.yaml.
        value: its value, as text.
        source: where it comes from.
    """

    key: str
    value: str
    source: str


@dataclass(frozen=True, slots=True)
class Todo:
    """A setting that is left to the user.

    Attributes:
        key: dotted key of rig.yaml.
        why: why it is not filled in, and what to do.
        needed: a calibration needs it.
    """

    key: str
    why: str
    needed: bool

    def __str__(self) -> str:
        """Key and reason; a reason that starts with the key stands for both."""
        return self.why if self.why.startswith(f"{self.key}.") else f"{self.key}: {self.why}"


@dataclass(frozen=True, slots=True)
class Draft:
    """Draft of a rig.yaml.

    Attributes:
        text: the file.
        filled: what was filled in, in the order of the file.
        todo: what is left to the user, in the order of the file.
        notes: complete sentences.
    """

    text: str
    filled: tuple[Filled, ...]
    todo: tuple[Todo, ...]
    notes: tuple[str, ...]
