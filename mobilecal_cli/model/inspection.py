"""Summary of a recording, and the result of a robot of `batch`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from mobilecal_cli.model.rig import CameraRig, HeadChain, Rig, Side, WheelSource


@dataclass(frozen=True, slots=True)
class TopicView:
    """One topic.

    Attributes:
        name, type: see `TopicInfo`.
        messages: number of messages; None if the file does not state it.
        rate_hz: from the median interval of the log times; None if they are unknown, or for one message.
        longest_gap_s, gap_at_s: the longest gap and its start, from the start of the recording; None likewise.
        steps_back: number of messages stored after one with a later log time; None likewise.
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
    """The board in a few images spread over the recording.

    Attributes:
        pictures: number of images searched.
        seen: number of images with a whole board of the most frequent size.
        size: (columns, rows) inner corners, None if no size is the most frequent.
        square_m: side of a square measured with the stereo pair, m: median over the pairs; None if no pair shows the
            board.
        squares_m: measured side in each pair, m.
        stated_m: side of a square as configured, m; None if it is not.
        other_sizes: number of images that show a whole board of another size.
    """

    pictures: int
    seen: int
    size: tuple[int, int] | None
    square_m: float | None = None
    squares_m: tuple[float, ...] = ()
    stated_m: float | None = None
    other_sizes: int = 0


@dataclass(frozen=True, slots=True)
class JointRange:
    """Lowest and highest reading of a head joint, and their unit ("deg" or "mm")."""

    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True)
class MotionView:
    """Motion of the robot.

    Attributes:
        joints: head joint → range.
        wheels_deg: side → total rotation forward and back over the recording, degrees.
        driven_m, turned_deg: path length and heading range, by the nominal wheels; None without these.
        rests: number of rests of base and head with images; None if the times of the images are unknown.
        share_read: share of the recording that was read for this, 1 for all of it.
    """

    joints: Mapping[str, JointRange]
    wheels_deg: Mapping[str, float]
    driven_m: float | None
    turned_deg: float | None
    rests: int | None
    share_read: float


@dataclass(frozen=True, slots=True)
class Lack:
    """Something that is missing for a calibration.

    Attributes:
        about: what it concerns, one of `Inspection.CRITERIA`.
        what: what is wrong.
        cure: what to do.
        exit_code: the exit code of `calibrate` for this, see `errors`.
    """

    about: str
    what: str
    cure: str
    exit_code: int


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Parts of the rig that are known, also where others are not.

    Attributes:
        images: image topic of each camera.
        cameras: the cameras.
        wheels: source of each wheel's rotation.
        chain: the head chain.
        chain_from: source of the chain.
        joints: topics with the readings of the chain's joints.
    """

    images: Mapping[str, str] | None = None
    cameras: CameraRig | None = None
    wheels: Mapping[Side, WheelSource] | None = None
    chain: HeadChain | None = None
    chain_from: str = ""
    joints: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """Summary of a recording.

    Attributes:
        CRITERIA: what is checked, in order; see `Lack.about`.
        name: path as given by the user.
        containers: file formats.
        size_bytes: total size.
        start_ns, end_ns: log times of the first and last message, None where unknown.
        topics: in order of name.
        rig: what `calibrate` would use, None if something is missing for it.
        parts: the parts of it that are known.
        board: None if no image can be read.
        motion: None if joints or wheels cannot be read.
        covered: number of images of the first camera within the time of the others, joints and wheels, and of all; None
            if their times are unknown.
        missing: what prevents a calibration.
        weak: what limits a calibration.
        notes: irregularities and losses, whole sentences.
    """

    CRITERIA: ClassVar[tuple[str, ...]] = (
        "rig.yaml",
        "recording",
        "cameras",
        "camera infos",
        "wheels",
        "head chain",
        "joints",
        "priors",
        "gates",
        "time",
        "motion",
        "board",
        "square size",
    )

    name: str
    containers: tuple[str, ...] = ()
    size_bytes: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    topics: tuple[TopicView, ...] = ()
    rig: Rig | None = None
    parts: Parts = Parts()
    board: BoardView | None = None
    motion: MotionView | None = None
    covered: tuple[int, int] | None = None
    missing: tuple[Lack, ...] = ()
    weak: tuple[Lack, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """The exit code that `calibrate` would end with; 0 if nothing is missing."""
        codes = [lack.exit_code for lack in self.missing]
        if not codes:
            return 0
        return codes[0] if self.rig is None else min(codes)


@dataclass(frozen=True, slots=True)
class FleetRow:
    """Result of one robot, or a directory entry that was skipped.

    Attributes:
        name: name of the robot, or of the entry.
        verdict: "PASS", "FAIL", "NOT ENOUGH", "GATE FAILED", "ERROR" without a result, or "SKIPPED" for an entry.
        exit_code: exit code of `mobilecal calibrate`.
        reason: one sentence.
        stations: number of stations used.
        rotvec_rad: rotation vector of the reference camera in the head frame, (3,); empty without a result.
        lengths_m: its position, then radius_right, radius_left, separation, (6,); empty without a result.
        std: nine standard deviations, rad and m, None where unknown; empty for methods that give none.
        skipped: why the robot was not calibrated in this run; empty if it was.
        hint: what to do next, if it did not pass.
        seconds: how long it took, s.
    """

    name: str
    verdict: str
    exit_code: int
    reason: str
    stations: int = 0
    rotvec_rad: tuple[float, ...] = ()
    lengths_m: tuple[float, ...] = ()
    std: tuple[float | None, ...] = ()
    skipped: str = ""
    hint: str = ""
    seconds: float = 0.0
