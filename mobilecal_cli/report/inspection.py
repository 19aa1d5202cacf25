"""The summary of a recording: what `inspect` and `check` print, as text and as JSON, and what `init` filled in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.model.rig import SIDES, CameraRig, Rig
from mobilecal_cli.model.signals import BoardView
from mobilecal_cli.model.text import listed, visible, wrapped
from mobilecal_cli.report.formats import Table, json_text
from mobilecal_cli.rig.draft import Draft
from mobilecal_cli.rig.resolve import Survey

#: Source of a setting in `Rig.setting_sources` → its text.
_WHY = {
    "log": "from names and types in the recording",
    "flag": "from an option",
    "file": "from the configuration",
}


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


State = Literal["ok", "limit", "problem", "unknown"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One criterion for a calibration.

    Attributes:
        about: what it concerns, one of `CRITERIA`.
        state: "limit": a calibration is possible, with limits; "problem": it is not; "unknown": another problem
            prevents the check.
        what: what was found, or what is wrong.
        cure: what to do, "" for nothing.
        exit_code: the exit code of `calibrate` for this, see `errors`.
    """

    about: str
    state: State
    what: str
    cure: str = ""
    exit_code: int = 0

    @classmethod
    def of(cls, about: str, error: MobilecalError, *, prevents: bool = True) -> Finding:
        """An error that prevents a calibration, or only limits it."""
        return cls(about, "problem" if prevents else "limit", error.message, error.hint, error.exit_code)


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """Summary of a recording.

    Attributes:
        name: path as given by the user.
        containers: file formats.
        size_bytes: total size.
        start_ns, end_ns: log times of the first and last message, None where unknown.
        topics: in order of name.
        rig: what `calibrate` would use, None if something is missing for it.
        survey: what is known of it, also where other parts are not; None if the recording cannot be read.
        board: None if no image can be read.
        motion: None if joints or wheels cannot be read.
        covered: number of images of the first camera within the time of the others, joints and wheels, and of all; None
            if their times are unknown.
        findings: what prevents or limits a calibration.
        notes: irregularities and losses, whole sentences.
    """

    name: str
    containers: tuple[str, ...] = ()
    size_bytes: int = 0
    start_ns: int | None = None
    end_ns: int | None = None
    topics: tuple[TopicView, ...] = ()
    rig: Rig | None = None
    survey: Survey | None = None
    board: BoardView | None = None
    motion: MotionView | None = None
    covered: tuple[int, int] | None = None
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[Finding, ...]:
        """What prevents a calibration."""
        return tuple(finding for finding in self.findings if finding.state == "problem")

    @property
    def weak(self) -> tuple[Finding, ...]:
        """What limits a calibration."""
        return tuple(finding for finding in self.findings if finding.state == "limit")

    @property
    def exit_code(self) -> int:
        """The exit code that `calibrate` would end with; 0 if nothing is missing."""
        codes = [line.exit_code for line in self.missing] or [0]
        return codes[0] if self.rig is None else min(codes)

    @property
    def duration_s(self) -> float | None:
        """Time from the first to the last message, s; None where unknown."""
        if self.start_ns is None or self.end_ns is None:
            return None
        return (self.end_ns - self.start_ns) * 1e-9


def inspection_json(inspection: Inspection) -> str:
    """The summary for programs; docs/reference/cli.md lists the keys."""
    rig, board = inspection.rig, inspection.board
    columns, rows = (board.size if board is not None else None) or (None, None)
    data = {
        "recording": _fields(
            inspection, "name", "containers", "size_bytes", "start_ns", "end_ns", "duration_s"
        ),
        "topics": inspection.topics,
        "roles": rig and rig.setting_sources,
        "head": rig
        and {
            **_fields(rig.chain, "base_frame", "head_frame", "joints"),
            "pan": rig.chain.pan or None,
            "tilt": rig.chain.tilt or None,
        },
        "cameras": rig and _cameras(rig.cameras),
        "board": board
        and {
            **_fields(board, "pictures", "seen"),
            "columns": columns,
            "rows": rows,
            "square_m": board.square_m,
            "square_stated_m": board.stated_m,
        },
        "motion": inspection.motion,
        "time": inspection.covered
        and {"images_covered": inspection.covered[0], "images": inspection.covered[1]},
        **_fields(inspection, "missing", "weak", "exit_code", "notes"),
    }
    return json_text(data, sort_keys=False)


def _fields(value: object, *names: str) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def _cameras(cameras: CameraRig) -> dict[str, Any]:
    each: dict[str, Any] = {
        name: {
            "frame": camera.frame_id,
            **_fields(camera, "width", "height"),
            "focal_px": camera.K.diagonal()[:2],
            "distortion": camera.distortion,
        }
        for name, camera in zip(cameras.names, cameras.each, strict=True)
    }
    return {**each, **_fields(cameras, "baseline_m", "rectified")}


def inspection_text(inspection: Inspection) -> str:
    """The summary for the terminal; control characters from the recording are escaped."""
    facts = [", ".join(inspection.containers), f"{inspection.size_bytes / 1e6:.1f} MB"]
    if inspection.duration_s is not None and inspection.start_ns is not None:
        start = datetime.fromtimestamp(inspection.start_ns // 10**9, UTC)
        facts += [f"{inspection.duration_s:.1f} s", f"from {start:%Y-%m-%d %H:%M:%S} UTC"]
    lines = [visible(inspection.name), f"  {', '.join(facts)}", "", *_topics(inspection)]
    sources = {} if inspection.rig is None else inspection.rig.setting_sources
    roles = (f"{role}: {_WHY.get(origin, origin)}" for role, origin in sources.items())
    lines += _section("Used for a calibration", roles)
    lines += ["", *_criteria(inspection)]
    conclusion = f"can be calibrated{', with limits' if inspection.weak else ''}"
    if inspection.missing:
        conclusion = f"cannot be calibrated as it is (exit code {inspection.exit_code})"
    return "\n".join([*lines, "", f"This recording {conclusion}."]) + "\n"


def _section(title: str, texts: Iterable[object]) -> list[str]:
    """An empty line, the title and the paragraphs; nothing without paragraphs."""
    lines = [line for text in texts for line in wrapped(str(text))]
    return ["", title, *lines] if lines else []


def _topics(inspection: Inspection) -> list[str]:
    rows = [
        (
            visible(topic.name),
            visible(topic.type),
            "?" if topic.messages is None else str(topic.messages),
            "" if topic.rate_hz is None else f"{topic.rate_hz:.1f} Hz",
            "" if gap_s is None else f"{gap_s:.3f} s at {topic.gap_at_s or 0:.1f} s",
            f"{topic.steps_back} out of order" if topic.steps_back else "",
        )
        for topic, gap_s in ((topic, topic.longest_gap_s) for topic in inspection.topics)
    ]
    return Table.of(("topic", "type", "number:messages", "number:rate", "longest gap", ""), rows).lines()


#: Criteria without which no other can be checked, those of the robot's description, and those of the recording.
_FIRST = ("rig.yaml", "recording")
_DESCRIBED = ("cameras", "camera infos", "wheels", "head chain", "joints", "priors", "gates")
_RECORDED = ("time", "motion", "board", "square size")
#: What is checked, in order; and what is listed for its problems only.
CRITERIA, _ONLY_PROBLEMS = (*_FIRST, *_DESCRIBED, *_RECORDED), (*_FIRST, "priors", "gates")


def checklist(inspection: Inspection) -> tuple[Finding, ...]:
    """All criteria, in order; one with several problems has several lines.

    A configuration that is invalid, or a recording that cannot be read, is the only line.
    """
    opened = tuple(finding for finding in inspection.missing if finding.about in _FIRST)
    if opened:
        return opened
    lines: list[Finding] = []
    known = {**_known(inspection.survey), **_measured(inspection)}
    unknown = "not checked, see the problems" if inspection.missing else "could not be measured"
    for about in CRITERIA:
        problems = [each for each in (*inspection.missing, *inspection.weak) if each.about == about]
        if problems or about in _ONLY_PROBLEMS:
            lines += problems
        else:
            lines.append(Finding(about, "ok" if about in known else "unknown", known.get(about, unknown)))
    return tuple(lines)


def _known(survey: Survey | None) -> dict[str, str]:
    said: dict[str, str] = {}
    if survey is None:
        return said
    sources, cameras, wheels = survey.sources, survey.cameras, survey.sources.wheels
    if sources.image:
        said["cameras"] = " and ".join(dict.fromkeys(sources.image.values()))
    if cameras is not None:
        sides = ", ".join(
            f"{name} {camera.width} x {camera.height} {camera.distortion}"
            for name, camera in zip(cameras.names, cameras.each, strict=True)
        )
        kind = "rectified" if cameras.rectified else "raw"
        baseline = "" if cameras.baseline_m is None else f"; baseline {cameras.baseline_m * 1e3:.1f} mm"
        said["camera infos"] = f"{sides}; {kind} images{baseline}"
    if wheels:
        said["wheels"] = ", ".join(f"{side} {wheels[side].where} on {wheels[side].topic}" for side in SIDES)
    if survey.head is not None:
        chain = survey.head.chain
        said["head chain"] = f"{chain.base_frame} to {chain.head_frame}, from the {survey.head.origin}"
        if not chain.joints:
            said["joints"] = f"camera fixed to {chain.base_frame}"
        else:
            topics = [*sources.joint_topics, *(source.topic for source in sources.elsewhere.values())]
            said["joints"] = f"{listed(chain.joints)} on {listed(dict.fromkeys(topics))}"
    return said


def _measured(inspection: Inspection) -> dict[str, str]:
    said = {}
    if inspection.covered is not None:
        covered, images = inspection.covered
        first, *others = (inspection.survey and inspection.survey.sources.image) or SIDES
        of_others = "".join(f"{name} images, " for name in others)
        said["time"] = (
            f"{covered} of {images} {first} images are within the time of {of_others}joints and wheels"
        )
    if inspection.motion is not None:
        motion = inspection.motion
        still = inspection.rig is not None and unseen_height(inspection.rig.chain) is not None
        shown = "all parameters but the camera's height" if still else "all nine parameters"
        stops = f"{motion.rests} stops with images; the motion determines {shown}"
        if motion.rests is None:
            partly = motion.share_read < 1
            why = "only a part of the recording was read" if partly else "log times step or are unknown"
            stops = f"stops not counted, as {why}"
        said["motion"] = f"{stops}; {', '.join(_ranges(motion))}"
    board = inspection.board
    if board is not None and board.size is not None:
        said["board"] = (
            f"{board.size[0]} x {board.size[1]} inner corners, whole in {board.seen} of {board.pictures} images"
        )
        if board.square_m is not None:
            stated = "not stated" if board.stated_m is None else f"{board.stated_m * 1e3:.2f} mm stated"
            said["square size"] = f"{board.square_m * 1e3:.2f} mm measured with the stereo pair, {stated}"
    return said


def _ranges(motion: MotionView) -> Iterator[str]:
    """What joints and wheels do over the recording."""
    for name, span in motion.joints.items():
        yield f"{name} {span.low:.0f} to {span.high:.0f} {span.unit}"
    yield from (f"{side} wheel {turned:.0f} deg" for side, turned in motion.wheels_deg.items())
    if motion.driven_m is not None:
        yield f"driven {motion.driven_m:.1f} m {'with the nominal wheels' if motion.wheels_deg else 'by the odometry'}"


def _criteria(inspection: Inspection) -> list[str]:
    """The criteria and the notes for the terminal; control characters from the recording are escaped."""
    lines = checklist(inspection)
    width = max(len(line.about) for line in lines)
    text = []
    for line in lines:
        start = f"{line.state:<7}  {line.about:<{width}}  "
        indent = " " * len(start)
        text += wrapped(line.what, start, indent)
        text += wrapped(f"hint: {line.cure}", indent, indent) if line.cure else []
    return text + [line for note in inspection.notes for line in wrapped(note, "note     ")]


def checklist_text(inspection: Inspection) -> str:
    """The criteria for the terminal, with the number of problems."""
    number = Counter(line.state for line in checklist(inspection))
    states: tuple[State, ...] = ("problem", "limit")
    counts = [f"{number[state]} {state}{'s' * (number[state] != 1)}" for state in states if number[state]]
    end = f" (exit code {inspection.exit_code})" if number["problem"] else ""
    return "\n".join([*_criteria(inspection), f"{', '.join(counts) or 'No problems'}{end}."]) + "\n"


def checklist_json(inspection: Inspection) -> str:
    """The criteria for programs; docs/reference/cli.md lists the keys."""
    data = {"lines": checklist(inspection), "notes": inspection.notes, "exit_code": inspection.exit_code}
    return json_text(data, sort_keys=False)


def draft_text(draft: Draft) -> str:
    """The settings with their sources, and the list of TODOs: those that a calibration needs first."""
    lines = ["Filled in"] if draft.filled else []
    width = max((len(entry.key) for entry in draft.filled), default=0)
    for entry in draft.filled:
        lines += wrapped(f"{entry.value} ({entry.source})", f"  {entry.key:<{width}}  ")
    for title, needed in (("TODO: needed for a calibration", True), ("TODO: optional", False)):
        lines += _section(title, (entry for entry in draft.todo if entry.needed == needed))
    lines += _section("Notes", draft.notes)
    return "\n".join(lines).lstrip("\n") + "\n"
