"""Commented draft of rig.yaml: what a recording and a URDF tell, each with its source, and what is left to the user."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.likelihood.constants import KINDS
from mobilecal_cli.model.rig import SIDES, JointLink, Nominal, WheelSource
from mobilecal_cli.model.signals import IMAGES, ODOMETRY, BoardView, NumberField
from mobilecal_cli.model.text import listed, visible
from mobilecal_cli.ranges import ACCURACY
from mobilecal_cli.rig.cameras import named_cameras
from mobilecal_cli.rig.config import (
    TODO,
    BoardConfig,
    CamerasConfig,
    HeadConfig,
    JointFieldConfig,
    NoiseConfig,
    Pose,
    WheelsConfig,
    WheelsNominal,
    read_urdf,
)
from mobilecal_cli.rig.head import pan_and_tilt
from mobilecal_cli.rig.names import counters, joint_state_names, named_as, tick_counters
from mobilecal_cli.rig.resolve import Part, Survey
from mobilecal_cli.rig.settings import link_settings, pose_settings, wheel_settings
from mobilecal_cli.rig.wheels import counter_width, nominal_wheels, urdf_wheels, wheel_distance_m

_WIDTH = 100
#: Names in a comment; a robot has fewer, and the file must stay short enough to be read.
_MOST_NAMES = 100
#: Whole boards that must be seen before their size is filled in.
_ENOUGH_BOARDS = 3
#: Stereo pairs, and their largest relative spread, for a suggestion of the size of the squares.
_ENOUGH_SQUARES, _SQUARE_SPREAD = 3, 0.02
#: Boards are made in whole millimeters: how far the measured size may be from one, relative.
_SQUARE_NEAR = 0.004
T = TypeVar("T")


class Filled(NamedTuple):
    """A setting that was filled in: the dotted key of rig.yaml, its value as text, and where it comes from."""

    key: str
    value: str
    source: str


class Todo(NamedTuple):
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


@dataclass
class Draft:
    """Draft of a rig.yaml, as it is written.

    Attributes:
        survey: what is known of the robot.
        urdf_path: of the URDF in use, as it is written to the file; None: that of the recording.
        board: the board in some images.
        notes: complete sentences.
        lines: the file.
        filled: what was filled in, in the order of the file.
        todo: what is left to the user, in the order of the file.
    """

    survey: Survey
    urdf_path: str | None
    board: BoardView | None
    notes: tuple[str, ...]
    lines: list[str] = field(default_factory=list)
    filled: list[Filled] = field(default_factory=list)
    todo: list[Todo] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The file. Names from the recording are also in comments, where YAML allows no control characters."""
        return "".join(f"{visible(line)}\n" for line in self.lines)

    def open(self, section: str, comment: str = "") -> str:
        """Write the key of a section, once, behind a comment sign if asked; returns the indentation of its keys."""
        if f"{section}:" in self.lines:
            return "  "
        if f"{comment}{section}:" not in self.lines:
            self.lines.append(f"{comment}{section}:")
        return f"{comment}  "

    def fill(self, key: str, value: object, source: str) -> None:
        """A value for a key of a section, with its source as a comment."""
        self.filled.append(Filled(key, _shown(value), source))
        section, _, name = key.partition(".")
        self.open(section)
        line = f"  {name}: {_flow(value)}"
        both = f"{line}  # {source}"
        self.lines += [both] if len(both) <= _WIDTH else [f"  # {source}", line]

    def ask(self, key: str, why: str, template: str, needed: bool = False, hints: Iterable[str] = ()) -> None:
        """A key that is left to the user, hints, and a template of keys of its section to fill in."""
        section, todo = key.partition(".")[0], Todo(key, why, needed)
        self.todo.append(todo)
        said = textwrap.wrap(f"TODO {todo}", _WIDTH, break_long_words=False, break_on_hyphens=False)
        own = "  " if f"{section}:" in self.lines else ""
        self.lines += [f"{own}# {line}" for line in (*said, *hints)]
        if template:
            inner = self.open(section, "# ")
            self.lines += [
                f"{inner}{'# ' if inner.isspace() else ''}{line}" for line in template.splitlines()
            ]

    def ask_for(self, part: Part, key: str, template: str = "", hints: Iterable[str] = ()) -> None:
        """What the survey lacks of one part; hints and template follow the last."""
        errors = [error for lack, error in self.survey.lacks if lack == part]
        for error in errors:
            why = " ".join(f"{error.message}; {error.hint}".removesuffix("; ").split())
            last = error is errors[-1]
            self.ask(key, why, template if last else "", True, hints if last else ())


def _quoted(text: str) -> str:
    """YAML string that any loader reads back unchanged, without characters that control a terminal."""
    return visible(json.dumps(text, ensure_ascii=False))  # YAML reads the escapes of both


def _flow(value: object) -> str:
    """A value as YAML on one line; lengths and angles below 1e-12 are rounding."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_flow(item)}' for key, item in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_flow(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{0.0 if abs(value) < 1e-12 else value:.10g}"
    return _quoted(value) if isinstance(value, str) and value != TODO else str(value)


def _shown(value: object) -> str:
    """A value for the summary."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_shown(item)}" for key, item in value.items())
    return value if isinstance(value, str) else _flow(value)


def _tried(step: Callable[[], T]) -> T | None:
    try:
        return step()
    except MobilecalError:
        return None


def _listing(title: str, names: Iterable[str]) -> str:
    return f"# {title}: {listed([_quoted(name) for name in sorted(names)], _MOST_NAMES)}"


def draft_rig(
    survey: Survey, log_name: str, urdf_path: str | None = None, board: BoardView | None = None
) -> Draft:
    """Draft of a rig.yaml.

    Where names, images or readings allow two answers, the user is asked.

    Args:
        survey: of the recording, with no more configured than the URDF to use in place of the one in the recording.
        log_name: shown in the first line.
        urdf_path: path of that URDF, as it is written to the file.
        board: the board in some images.
    """
    draft = Draft(survey, urdf_path, board, () if survey.head is None else survey.head.notes)
    draft.lines += [
        f"# rig.yaml for mobilecal, drafted from {_quoted(log_name)}.",
        "# The comment of a value says where it comes from. Fill in or delete what is marked TODO, then test the file",
        "# with mobilecal check. Every key is optional if the recording contains the information.",
        "schema_version: 1",
    ]
    for section in (_board, _cameras, _wheels, _joints, _head, _nominal):
        draft.lines.append("")
        section(draft)
    kinds = [(f"#   {kind.name}: {kind.sigma * kind.shown:.4g}", kind) for kind in KINDS]
    width = max(len(entry) for entry, _ in kinds)
    draft.lines += [
        "",
        "# known standard deviations; those omitted are estimated from the recording",
        f"# noise: {NoiseConfig.example}",
        "",
        "# the accuracy that this robot needs (1 sigma; here the defaults for a robot of usual size): verdict, report",
        "# and suggestions go by it",
        "# gates:",
        *(f"#   {name}: {limit:g}" for name, limit in ACCURACY.items()),
        "",
        "# how well the stated constants of the robot are known: one standard deviation of each, fixed (exact) or free",
        "# (ignored). all: fixed makes every constant exact; an entry for a single constant, such as focal_left,",
        "# overrides that of its kind.",
        "# priors:",
        *(f"{entry:{width}}  # {kind.shown_unit}: {kind.meaning}" for entry, kind in kinds),
    ]
    return draft


def _board(draft: Draft) -> None:
    board = draft.board
    if board is None:
        draft.lines += ["# inner corners and squares of the board; no images to find it in"]
        draft.lines += ["# board:", *(f"#   {line}" for line in BoardConfig.example.splitlines())]
    elif board.size is None or board.seen < _ENOUGH_BOARDS or board.other_sizes:
        what = f"board of {board.size[0]} x {board.size[1]}" if board.size else "checkerboard of one size"
        others = f", {board.other_sizes} a board of another size" if board.other_sizes else ""
        draft.ask(
            "board",
            f"{board.seen} of {board.pictures} images show a whole {what}{others}; count the inner corners, or set "
            "kind for a board with markers",
            BoardConfig.example,
            needed=board.size is None,
        )
    else:
        source = f"images: inner corners of the checkerboard, whole in {board.seen} of {board.pictures}"
        for name, count in zip(("columns", "rows"), board.size, strict=True):
            draft.fill(f"board.{name}", count, source)
        _square(draft, board)


def _square(draft: Draft, board: BoardView) -> None:
    """The size of the squares is only suggested: the stereo baseline that it is measured with may be wrong."""
    images, sides, measured_m = draft.survey.sources.image, board.squares_m, board.square_m
    if images and tuple(images) != SIDES:
        draft.lines.append(
            "  # square_m: 0.08  # measured with a ruler: cameras that are no stereo pair do not show it"
        )
        return
    why, suggested_m = "measure ten squares with a ruler; until then, the stereo pair gives the scale", 0.08
    if measured_m and len(sides) >= _ENOUGH_SQUARES and np.ptp(sides) <= _SQUARE_SPREAD * min(sides):
        whole_mm = abs(round(measured_m, 3) - measured_m) < _SQUARE_NEAR * measured_m
        suggested_m = round(measured_m, 3 if whole_mm else 4)
        why += f". Suggestion: {suggested_m * 1e3:g} mm ({measured_m * 1e3:.2f} mm by {len(sides)} stereo pairs and "
        why += "the baseline in camera_info)"
    draft.ask("board.square_m", why, f"square_m: {suggested_m:g}")


def _cameras(draft: Draft) -> None:
    sources, description = draft.survey.sources, draft.survey.description
    present = (topic.name for topic in description.topics if topic.type in IMAGES)
    draft.lines.append(_listing("image topics in the recording", present))
    if not sources.image:
        named = named_cameras(description)
        several = "\n".join(f"{name}: {{image: {_quoted(topic)}}}" for name, topic in named.items())
        draft.ask_for("cameras", "cameras", several or CamerasConfig.example)
        return
    for name, image in sources.image.items():
        entry = {"image": image} | ({"info": sources.info[name]} if name in sources.info else {})
        draft.fill(f"cameras.{name}", entry, "recording: names and types of the topics")
    draft.ask_for("camera infos", "cameras")
    draft.lines.append(
        f"  reference: {next(iter(sources.image))}  # default: camera of the head-eye transform"
    )
    draft.fill("cameras.rectified", draft.survey.rectified, "name of the image topic")


def _wheels(draft: Draft) -> None:
    draft.lines.append(
        "# sign: -1 is for a wheel whose readings decrease when driving forward; a calibration names it"
    )
    sources, description = draft.survey.sources.wheels, draft.survey.description
    counted = counters(description.numbers)
    ticks = tick_counters(counted)
    if sources and sources["left"].assumed:
        why = "recording: no wheels, and the only odometry that is named as theirs"
        draft.fill("wheels.odometry", sources["left"].topic, why)
        draft.lines += [
            "  # odometry_separation_m: 0.4  # wheel_separation in the driver; it only scales the difference of the",
            "  # multipliers of the left and right radius",
        ]
    elif sources:
        for side in SIDES:
            kind = "counters of a known driver" if sources[side].field else "the only joints named as wheels"
            draft.fill(f"wheels.{side}", wheel_settings(sources[side]), f"recording: {kind}")
    elif ticks is not None:
        for side in SIDES:
            _counters(draft, f"wheels.{side}", ticks[side])
        draft.ask(
            "wheels.left.ticks_per_revolution, wheels.right.ticks_per_revolution",
            "counter steps per turn of the wheel: encoder steps times gear ratio; no recording contains them",
            "",
            needed=True,
        )
    else:
        candidates = [_candidate(number) for sides in counted for side in SIDES for number in sides[side]]
        odometry = [topic.name for topic in description.topics if topic.type == ODOMETRY]
        candidates += [f"or: wheels: {{odometry: {_quoted(topic)}}}" for topic in odometry[:1]]
        draft.ask_for("wheels", "wheels", WheelsConfig.example, candidates)


def _counters(draft: Draft, key: str, numbers: Sequence[NumberField]) -> None:
    """The counters of one side, which lack the steps per turn of the wheel."""
    width, said = counter_width(numbers[0]), "they did not start again"
    if numbers[0].wraps is not None:
        said = f"bits: they start again after 2^{numbers[0].wraps} steps"
    elif width is not None:
        said = "bits: width of their type"
    first, *others = (WheelSource(number.topic, field=number.path, bits=width) for number in numbers)
    entry = {**wheel_settings(replace(first, others=tuple(others))), "ticks_per_revolution": TODO}
    draft.fill(key, entry, f"recording: the only whole numbers named as counters; {said}")


def _candidate(number: NumberField) -> str:
    kind = "whole number" if number.integer else "number, unit unknown"
    jumps = "" if number.jump is None else f", jumps by {number.jump}"
    return f"candidate: topic {_quoted(number.topic)}, field {_quoted(number.path)} ({kind}{jumps})"


def _joints(draft: Draft) -> None:
    survey, names = draft.survey, joint_state_names(draft.survey.description)
    draft.lines.append(_listing("joints in the recording's joint states", names))
    chain = None if survey.head is None else survey.head.chain
    if len(topics := survey.sources.joint_topics) == 1 and not survey.sources.elsewhere:
        draft.fill("joints.topic", topics[0], "recording: the only one with the head's joints")
    found = _tried(lambda: pan_and_tilt(survey.config, names)) or ("", "")
    for role, name in zip(("pan", "tilt"), (chain.pan, chain.tilt) if chain else found, strict=True):
        if name:
            draft.fill(f"joints.{role}", name, "name of the joint")
    missing = () if chain is None else [name for name in chain.joints if name not in names]
    template = [f"  {_quoted(name)}: {JointFieldConfig.example}" for name in missing]
    key, first = ("joints.fields", "fields:") if missing else ("joints.topic", "topic: TOPIC")
    candidates = [_candidate(n) for name in missing for n in named_as(name, survey.description.numbers)]
    draft.ask_for("joints", key, "\n".join([first, *template]), candidates)


def _head(draft: Draft) -> None:
    head, urdf_path = draft.survey.head, draft.urdf_path
    if head is not None:
        chain, source = head.chain, "the given URDF" if urdf_path else head.origin
        if urdf_path is not None:
            draft.fill("head.urdf", urdf_path, "option --urdf")
        draft.fill("head.base_frame", chain.base_frame, source)
        draft.fill("head.head_frame", chain.head_frame, f"{source}: link of the last head joint")
        draft.lines += [
            f"  # joint positions, from the {source}: from the vehicle frame (midway between the wheels) to the head;",
            "  # to change them, delete the comment signs" + (" and the line urdf" if urdf_path else ""),
            "  # chain:",
        ]
        for link in chain.links:
            line = f"  #   - {_flow(link_settings(link))}"
            if isinstance(link, JointLink) and (link.multiplier, link.offset) != (1.0, 0.0):
                line += f"  # times {link.multiplier:g} plus {link.offset:g}: only in a URDF"
            draft.lines.append(line)
    draft.ask_for("head chain", "head", "" if head else HeadConfig.example)


def _nominal(draft: Draft) -> None:
    survey = draft.survey
    drawn = Nominal() if survey.head is None else survey.head.drawn
    texts = [read_urdf(survey.config), *(text for _, text in sorted(survey.description.urdfs.items()))]
    text = next(filter(None, texts), None)
    urdf = None if text is None else _tried(lambda: parse_urdf(text))  # the given one, or a recorded one
    joints = (urdf and _tried(lambda: urdf_wheels(urdf, survey.sources.wheels))) or {}
    if urdf is not None and drawn.wheels is None:
        drawn = replace(drawn, wheels=_tried(lambda: nominal_wheels(urdf, joints, urdf.root)))
    draft.lines.append(
        "# nominal values: for what the recording does not determine, and to unwrap large turns"
    )
    if drawn.wheels is not None:
        sizes = {name: getattr(drawn.wheels, name) for name in WheelsNominal.model_fields}
        source = "URDF: cylinders of the wheels' links, distance of the wheels' joints"
        draft.fill("nominal.wheels", sizes, source)
    if drawn.T_h_reference is not None:
        source = "URDF: fixed joints from the head to the camera's frame"
        draft.fill("nominal.head_eye", pose_settings(drawn.T_h_reference), source)
    if drawn.wheels is None:
        apart = urdf and _tried(lambda: wheel_distance_m(urdf, joints, urdf.root))
        told = "" if not apart else f"; the URDF's wheel joints are {apart:.10g} m apart, radii are not in it"
        sizes = {"radius_left_m": TODO, "radius_right_m": TODO, "separation_m": apart or TODO}
        draft.ask("nominal.wheels", f"measure the wheels with a ruler{told}", f"wheels: {_flow(sizes)}")
    if drawn.T_h_reference is None:
        why = "pose of the camera's optical frame in the head frame, by a ruler; only needed if the motion does not "
        draft.ask("nominal.head_eye", f"{why}show it", f"head_eye: {Pose.example}")
