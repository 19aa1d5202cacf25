"""Result of `inspect`: contents of a recording and its fitness for calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mobilecal_cli.model.rig import Rig


@dataclass(frozen=True, slots=True)
class TopicView:
    """One topic.

    Attributes:
        name, type: see `TopicInfo`.
        messages: number of messages; None if the file does not contain it.
        rate_hz: from the median interval of the log times; None without them or with one message.
        longest_gap_s, gap_at_s: longest gap and its start after the start of the recording; None likewise.
        steps_back: number of messages that follow one with a later log time; None likewise.
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
    """The board in a sample of images spread over the recording.

    Attributes:
        pictures: number of images searched.
        seen: number of images with a complete board of the most frequent size.
        size: (columns, rows) inner corners, None if no size is most frequent.
    """

    pictures: int
    seen: int
    size: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class JointRange:
    """Range of a head joint: lowest and highest reading, and their unit ("deg" or "mm")."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True)
class MotionView:
    """Motion of the robot.

    Attributes:
        joints: head joint → range.
        wheels_deg: side → total rotation, forward and backward, deg.
        driven_m, turned_deg: distance and range of the heading with the nominal wheels; None without them.
        rests: number of rests of base and head with images; None if the image times are unknown.
        share: share of the recording that was read, 0 to 1.
    """

    joints: Mapping[str, JointRange]
    wheels_deg: Mapping[str, float]
    driven_m: float | None
    turned_deg: float | None
    rests: int | None
    share: float


@dataclass(frozen=True, slots=True)
class Lack:
    """Something that a calibration lacks: the problem, and what to do."""

    what: str
    cure: str


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """Overview of a recording.

    Attributes:
        name: path as given by the user.
        containers: file formats.
        size_bytes: total size.
        start_ns, end_ns: log times of the first and last message, None where unknown.
        topics: sorted by name.
        rig: the robot as `calibrate` would use it, None if something is missing.
        board: None if no images could be searched.
        motion: None if joints or wheels could not be read.
        missing: problems that prevent a calibration.
        weak: problems that leave parameters unobservable or uncertain.
        notes: irregularities and lost data; whole sentences.
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
