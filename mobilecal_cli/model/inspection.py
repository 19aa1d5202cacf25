"""What a look at a recording tells, before any of it is measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mobilecal_cli.model.rig import Rig


@dataclass(frozen=True, slots=True)
class TopicView:
    """One topic.

    Attributes:
        name, type: see `TopicInfo`.
        messages: how many; None where the file does not say.
        rate_hz: by the median interval of the log times; None where they are not known, or there is one message.
        longest_gap_s, gap_at_s: the longest pause, and when it began, from the start of the log; None likewise.
        steps_back: messages that lie in the file behind one of a later log time; None likewise.
    """

    name: str
    type: str
    messages: int | None
    rate_hz: float | None
    longest_gap_s: float | None
    gap_at_s: float | None
    steps_back: int | None


@dataclass(frozen=True, slots=True)
class BoardView:
    """The board in a few pictures spread over the log.

    Attributes:
        pictures: how many were looked at.
        seen: in how many of them a whole board of the commonest size was.
        size: (columns, rows) inner corners, None where no size leads.
    """

    pictures: int
    seen: int
    size: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class JointRange:
    """Where a head joint was: its lowest and highest reading, and their unit ("deg" or "mm")."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True)
class MotionView:
    """How the robot moved.

    Attributes:
        joints: head joint → range.
        wheels_deg: side → rotation over the whole log, degrees, back and forth both counted.
        driven_m, turned_deg: length of the way, and range of the heading, by the nominal wheels; None without these.
        rests: how often base and head stood still with pictures; None where pictures' times are not known.
        share: of the recording that this rests on, 1 for all of it.
    """

    joints: Mapping[str, JointRange]
    wheels_deg: Mapping[str, float]
    driven_m: float | None
    turned_deg: float | None
    rests: int | None
    share: float


@dataclass(frozen=True, slots=True)
class Lack:
    """Something that a calibration would want: what is wrong, and what to do."""

    what: str
    cure: str


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """A recording at a glance.

    Attributes:
        name: as the user gave it.
        containers: kinds of files.
        size_bytes: of all files.
        start_ns, end_ns: log times of the first and last message, None where unknown.
        topics: in order of name.
        rig: what would be used, None where something is missing for it.
        board: None where no pictures could be looked at.
        motion: None where joints or wheels could not be read.
        missing: without these there is no calibration.
        weak: with these a calibration shows less than it could.
        notes: what was odd, and what was lost; whole sentences.
    """

    name: str
    containers: tuple[str, ...]
    size_bytes: int
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicView, ...]
    rig: Rig | None
    board: BoardView | None
    motion: MotionView | None
    missing: tuple[Lack, ...]
    weak: tuple[Lack, ...]
    notes: tuple[str, ...]
