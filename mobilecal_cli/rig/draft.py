"""Commented draft of rig.yaml: what a recording and a URDF tell, each with its source, and what is left to the user."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics.urdf import Urdf, parse_urdf
from mobilecal_cli.likelihood.nuisance import KINDS
from mobilecal_cli.model import (
    IMAGES,
    ODOMETRY,
    SIDES,
    BoardView,
    FixedLink,
    HeadChain,
    Nominal,
    NumberField,
    RobotDescription,
    Side,
    WheelSource,
)
from mobilecal_cli.model.text import listed, visible
from mobilecal_cli.ranges import ACCURACY
from mobilecal_cli.rig.cameras import named_cameras
from mobilecal_cli.rig.config import (
    TODO,
    UNCONFIGURED,
    BoardConfig,
    CamerasConfig,
    HeadConfig,
    HeadEyeNominal,
    JointFieldConfig,
    NoiseConfig,
    WheelsConfig,
    WheelsNominal,
    read_urdf,
)
from mobilecal_cli.rig.head import pan_and_tilt
from mobilecal_cli.rig.names import counters, joint_state_names, named_as, tick_counters
from mobilecal_cli.rig.resolve import Part, Survey
from mobilecal_cli.rig.settings import pose_settings
from mobilecal_cli.rig.wheels import counter_width, nominal_wheels, wheel_distance_m

_WIDTH = 100
#: Names in a comment; a robot has fewer, and the file must stay short enough to be read.
_MOST_NAMES = 100
#: Whole boards that must be seen before their size is filled in.
_ENOUGH_BOARDS = 3
#: Stereo pairs, and their largest relative spread, for a suggestion of the size of the squares.
_ENOUGH_SQUARES, _SQUARE_SPREAD = 3, 0.02
#: Sizes that boards are made in, m, coarse first; and how far the measured size may be from one, relative.
_SQUARE_STEPS_M, _SQUARE_NEAR = (0.01, 0.005, 0.001), 0.004
T = TypeVar("T")


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


@dataclass
class Draft:
    """Draft of a rig.yaml, as it is written.

    Attributes:
        survey: what is known of the robot.
        notes: complete sentences.
        lines: the file.
        filled: what was filled in, in the order of the file.
        todo: what is left to the user, in the order of the file.
    """

    survey: Survey
    notes: tuple[str, ...]
    lines: list[str] = field(default_factory=list)
    filled: list[Filled] = field(default_factory=list)
    todo: list[Todo] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The file. Names from the recording are also in comments, where YAML allows no control characters."""
        return "".join(f"{visible(line)}\n" for line in self.lines)

    def fill(self, key: str, text: str, source: str, value: str | None = None) -> None:
        """A key of a section as YAML, with its source as a comment; and its value for the summary, if not the text."""
        self.filled.append(Filled(key, text if value is None else value, source))
        section, _, name = key.partition(".")
        if f"{section}:" not in self.lines:
            self.lines.append(f"{section}:")
        line = f"  {name}: {text}"
        both = f"{line}  # {source}"
        self.lines += [both] if len(both) <= _WIDTH else [f"  # {source}", line]

    def ask(self, key: str, why: str, *template: str, needed: bool, indent: str = "") -> None:
        """A key that is left to the user, and lines to fill in."""
        self.todo.append(Todo(key, why, needed))
        said = textwrap.wrap(f"TODO {self.todo[-1]}", _WIDTH, break_long_words=False, break_on_hyphens=False)
        self.lines += [f"{indent}# {line}" for line in (*said, *template)]

    def ask_for(self, part: Part, key: str, *template: str, indent: str = "") -> None:
        """What the survey lacks of one part; the lines to fill in follow the last."""
        errors = [error for lack, error in self.survey.lacks if lack == part]
        for error in errors:
            why = " ".join(f"{error.message}; {error.hint}".removesuffix("; ").split())
            self.ask(key, why, *(template if error is errors[-1] else ()), needed=True, indent=indent)


def _quoted(text: str) -> str:
    """YAML string that any loader reads back unchanged, without characters that control a terminal."""
    return visible(json.dumps(text, ensure_ascii=False))  # YAML reads the escapes of both


def _flow(value: object) -> str:
    """A value as YAML on one line; lengths and angles below 1e-12 are rounding."""
    if isinstance(value, Mapping):
        return f"{{{_entries(value)}}}"
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{', '.join(_flow(item) for item in value)}]"
    if isinstance(value, float):
        return f"{0.0 if abs(value) < 1e-12 else value:.10g}"
    return _quoted(value) if isinstance(value, str) and value != TODO else str(value)


def _entries(values: Mapping[str, object]) -> str:
    """Keys and values of a YAML mapping on one line, without those that are None."""
    return ", ".join(f"{key}: {_flow(value)}" for key, value in values.items() if value is not None)


def _tried(step: Callable[[], T]) -> T | None:
    try:
        return step()
    except MobilecalError:
        return None


def _example(name: str, section: type[CamerasConfig | WheelsConfig | HeadConfig]) -> list[str]:
    return [f"{name}:", *(f"  {line}" for line in section.example.splitlines())]


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
    description = survey.description
    draft = Draft(survey, () if survey.head is None else survey.head.notes)
    draft.lines += [
        f"# rig.yaml for mobilecal, drafted from {_quoted(log_name)}.",
        "# The comment of a value says where it comes from. Fill in or delete what is marked TODO, then test the file",
        "# with mobilecal check. Every key is optional if the recording contains the information.",
        "schema_version: 1",
        "",
    ]
    text = read_urdf(survey.config) or next((text for _, text in sorted(description.urdfs.items())), None)
    urdf = None if text is None else _tried(lambda: parse_urdf(text))
    for write in (
        partial(_board, draft, board),
        partial(_cameras, draft, description),
        partial(_wheels, draft, description),
        partial(_joints, draft, description),
        partial(_head, draft, urdf_path),
        partial(_nominal, draft, urdf),
    ):
        write()
        draft.lines.append("")
    kinds = [(f"#   {kind.name}: {kind.sigma * kind.shown:.4g}", kind) for kind in KINDS]
    width = max(len(entry) for entry, _ in kinds)
    draft.lines += [
        "# known standard deviations; those omitted are estimated from the recording",
        f"# noise: {NoiseConfig.example}",
        "",
        "# the accuracy that this robot needs (1 sigma; here the defaults): verdict, report and suggestions go by it",
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


def _board(draft: Draft, board: BoardView | None) -> None:
    template = f"board: {BoardConfig.example}"
    if board is None:
        draft.lines += ["# inner corners and squares of the board; no images to find it in", f"# {template}"]
        return
    if board.size is None or board.seen < _ENOUGH_BOARDS or board.other_sizes:
        what = f"board of {board.size[0]} x {board.size[1]}" if board.size else "checkerboard of one size"
        others = f", {board.other_sizes} a board of another size" if board.other_sizes else ""
        draft.ask(
            "board",
            f"{board.seen} of {board.pictures} images show a whole {what}{others}; count the inner corners, or set "
            "kind for a board with markers",
            template,
            needed=board.size is None,
        )
        return
    columns, rows = board.size
    source = f"images: inner corners of the checkerboard, whole in {board.seen} of {board.pictures}"
    draft.fill("board.columns", str(columns), source)
    draft.fill("board.rows", str(rows), source)
    _square(draft, board)


def _square(draft: Draft, board: BoardView) -> None:
    """The size of the squares is only suggested: the stereo baseline that it is measured with may be wrong."""
    images = draft.survey.images
    if images is not None and tuple(images) != SIDES:
        draft.lines += [
            "  # square_m: 0.08  # measured with a ruler: cameras that are no stereo pair do not show it"
        ]
        return
    why = "measure ten squares with a ruler; until then, the stereo pair gives the scale"
    sides = board.squares_m
    if board.square_m is None or len(sides) < _ENOUGH_SQUARES or np.ptp(sides) > _SQUARE_SPREAD * min(sides):
        draft.ask("board.square_m", why, "square_m: 0.08", needed=False, indent="  ")
        return
    measured = f"{board.square_m * 1e3:.2f} mm by {len(sides)} stereo pairs and the baseline in camera_info"
    likely = likely_square_m(board.square_m)
    suggested = likely if likely is not None else round(board.square_m, 4)
    kind = "a usual size" if likely is not None else "no usual size"
    draft.ask(
        "board.square_m",
        f"{why}. Suggestion: {suggested * 1e3:g} mm, {kind} ({measured})",
        f"square_m: {suggested:g}",
        needed=False,
        indent="  ",
    )


def likely_square_m(measured_m: float) -> float | None:
    """The coarsest usual size near a measured one, m; None if there is none, or if any size would have a usual one."""
    for step in _SQUARE_STEPS_M:
        size = round(measured_m / step) * step
        if (
            size
            and step > 4 * _SQUARE_NEAR * measured_m
            and abs(size - measured_m) < _SQUARE_NEAR * measured_m
        ):
            return round(size, 6)
    return None


def _cameras(draft: Draft, description: RobotDescription) -> None:
    images, infos = draft.survey.images, draft.survey.infos
    present = (topic.name for topic in description.topics if topic.type in IMAGES)
    draft.lines.append(_listing("image topics in the recording", present))
    if images is None:
        named = named_cameras(UNCONFIGURED, description)
        several = ["cameras:", *(f"  {name}: {{image: {_quoted(topic)}}}" for name, topic in named.items())]
        draft.ask_for("cameras", "cameras", *(several if named else _example("cameras", CamerasConfig)))
        return
    for name, image in images.items():
        info = infos.get(name)
        value = image if info is None else f"{image}, {info}"
        entry = _flow({"image": image, "info": info})
        draft.fill(f"cameras.{name}", entry, "recording: names and types of the topics", value)
    draft.ask_for("camera infos", "cameras", indent="  ")
    draft.lines.append(f"  reference: {next(iter(images))}  # default: camera of the head-eye transform")
    rectified = "true" if draft.survey.rectified else "false"
    draft.fill("cameras.rectified", rectified, "name of the image topic")


def _wheels(draft: Draft, description: RobotDescription) -> None:
    draft.lines.append(
        "# sign: -1 is for a wheel whose readings decrease when driving forward; a calibration names it"
    )
    sources, counted = draft.survey.wheels, counters(description.numbers)
    whole = tick_counters(counted)
    if sources is not None and sources["left"].assumed:
        topic = sources["left"].topic
        why = "recording: no wheels, and the only odometry that is named as theirs"
        draft.fill("wheels.odometry", _quoted(topic), why, topic)
        draft.lines += [
            "  # odometry_separation_m: 0.4  # wheel_separation in the driver; it only scales the difference of the",
            "  # multipliers of the left and right radius",
        ]
    elif sources is not None:
        for side in SIDES:
            _wheel(draft, side, sources[side])
    elif len(counted) == 1 and whole:
        for side in SIDES:
            _counter(draft, side, whole[0][side])
        draft.ask(
            "wheels.left.ticks_per_revolution, wheels.right.ticks_per_revolution",
            "counter steps per turn of the wheel: encoder steps times gear ratio; no recording contains them",
            needed=True,
            indent="  ",
        )
    else:
        each = (number for by_side in counted for side in SIDES for number in by_side[side])
        candidates = (f"candidate: {_described(number)}" for number in each)
        draft.ask_for("wheels", "wheels", *candidates, *_example("wheels", WheelsConfig))
        odometry = [topic.name for topic in description.topics if topic.type == ODOMETRY]
        if odometry:
            draft.lines.append(f"# or: wheels: {{odometry: {_quoted(odometry[0])}}}")


def _wheel(draft: Draft, side: Side, source: WheelSource) -> None:
    """The wheels of one side that the survey found."""
    parts = source.every
    where = ", ".join(f"{part.joint or part.field} on {part.topic}" for part in parts)
    if source.joint is not None:
        topic = source.topic if len({part.topic for part in parts}) == 1 else None
        joints = [part.joint for part in parts]
        several = {"joint": joints[0]} if len(parts) == 1 else {"joints": joints}
        kind = "pair of joints" if len(parts) == 1 else "set of joints"
        draft.fill(
            f"wheels.{side}",
            _flow({"topic": topic, **several, "sign": source.sign}),
            f"recording: the only {kind} named as wheels",
            where,
        )
        return
    counted = {"ticks_per_revolution": source.ticks_per_revolution, "bits": source.bits}
    places = _fields([(part.topic, part.field or "") for part in parts])
    draft.fill(f"wheels.{side}", _flow(places | counted), "recording: counters of a known driver", where)


def _fields(places: Sequence[tuple[str, str]]) -> dict[str, object]:
    """Topics and fields of counters, as in a `wheels.left`."""
    topics, paths = [topic for topic, _ in places], [path for _, path in places]
    if len(places) == 1:
        return {"topic": topics[0], "field": paths[0]}
    where: dict[str, object] = {"topic": topics[0]} if len(set(topics)) == 1 else {"topics": topics}
    return {**where, "fields": paths}


def _counter(draft: Draft, side: Side, numbers: Sequence[NumberField]) -> None:
    number = numbers[0]
    width, said = counter_width(number), "it did not start again"
    if number.wraps is not None:
        said = f"bits: it starts again after 2^{number.wraps} steps"
    elif width is not None:
        said = "bits: width of its type"
    entry = _fields([(counter.topic, counter.path) for counter in numbers]) | {
        "ticks_per_revolution": TODO,
        "bits": width,
    }
    kind = "pair" if len(numbers) == 1 else "set"
    source = f"recording: the only {kind} of whole numbers named as counters; {said}"
    shown = ", ".join(f"{counter.path} on {counter.topic}" for counter in numbers)
    draft.fill(f"wheels.{side}", _flow(entry), source, shown + ("" if width is None else f", bits: {width}"))


def _described(number: NumberField) -> str:
    kind = "whole number" if number.integer else "number, unit unknown"
    jumps = "" if number.jump is None else f", jumps by {number.jump}"
    return f"topic {_quoted(number.topic)}, field {_quoted(number.path)} ({kind}{jumps})"


def _joints(draft: Draft, description: RobotDescription) -> None:
    survey, names = draft.survey, joint_state_names(description)
    draft.lines.append(_listing("joints in the recording's joint states", names))
    if survey.head is not None:
        chain = survey.head.chain
        pan, tilt = chain.pan, chain.tilt
    else:
        pan, tilt = _tried(lambda: pan_and_tilt(UNCONFIGURED, names)) or ("", "")
    only_topic = survey.joints and len(survey.joints) == 1 and not survey.elsewhere
    keys = {"topic": survey.joints[0]} if survey.joints and only_topic else {}
    keys |= {key: name for key, name in (("pan", pan), ("tilt", tilt)) if name}
    for key, value in keys.items():
        source = "recording: the only one with the head's joints" if key == "topic" else "name of the joint"
        draft.fill(f"joints.{key}", _quoted(value), source, value)
    missing = () if survey.head is None else [n for n in survey.head.chain.joints if n not in names]
    named = [number for name in missing for number in named_as(name, description.numbers)]
    template = ["fields:", *(f"  {_quoted(name)}: {JointFieldConfig.example}" for name in missing)]
    if not keys:
        template = ["joints:", *(f"  {line}" for line in template)]
    candidates = (f"candidate: {_described(number)}" for number in named)
    draft.ask_for("joints", "joints.fields", *candidates, *template, indent="  " if keys else "")


def _head(draft: Draft, urdf_path: str | None) -> None:
    head = draft.survey.head
    if head is None:
        draft.ask_for("head chain", "head", *_example("head", HeadConfig))
        return
    chain, source = head.chain, "the given URDF" if urdf_path else head.origin
    if urdf_path is not None:
        draft.fill("head.urdf", _quoted(urdf_path), "option --urdf", urdf_path)
    draft.fill("head.base_frame", _quoted(chain.base_frame), source, chain.base_frame)
    last = f"{source}: link of the last head joint"
    draft.fill("head.head_frame", _quoted(chain.head_frame), last, chain.head_frame)
    draft.lines += [
        f"  # joint positions, from the {source}: from the vehicle frame (midway between the wheels) to the head;",
        "  # to change them, delete the comment signs" + (" and the line urdf" if urdf_path else ""),
        "  # chain:",
        *(f"  #   - {link}" for link in _links(chain)),
    ]
    draft.ask_for("head chain", "head", indent="  ")


def _links(chain: HeadChain) -> list[str]:
    """The links of a chain as in rig.yaml; a mimic joint with its relation as a comment."""
    lines = []
    for link in chain.links:
        if isinstance(link, FixedLink):
            T = link.T_parent_child
            turned = se3.to_rpy(T[:3, :3])
            rpy = turned if np.any(np.abs(turned) > 1e-12) else None
            lines.append(_flow({"xyz_m": T[:3, 3], "rpy_rad": rpy}))
            continue
        line = f"joint: {_quoted(link.joint)}, axis: {_flow(link.axis)}"
        line = f"{{{line}, kind: prismatic}}" if link.kind == "prismatic" else f"{{{line}}}"
        if (link.multiplier, link.offset) != (1.0, 0.0):
            line += f"  # times {link.multiplier:g} plus {link.offset:g}: only in a URDF"
        lines.append(line)
    return lines


def _nominal(draft: Draft, urdf: Urdf | None) -> None:
    survey = draft.survey
    drawn = Nominal() if survey.head is None else survey.head.drawn
    if urdf is not None and drawn.wheels is None:
        drawn = replace(drawn, wheels=_tried(lambda: nominal_wheels(urdf, survey.wheels or {}, urdf.root)))
    draft.lines.append(
        "# nominal values: for what the recording does not determine, and to unwrap large turns"
    )
    filled = drawn.wheels is not None or drawn.T_h_reference is not None
    indent, inner = ("  ", "") if filled else ("", "  ")
    draft.lines.append("nominal:" if filled else "# nominal:")
    if drawn.wheels is not None:
        value = _entries({name: getattr(drawn.wheels, name) for name in WheelsNominal.model_fields})
        source = "URDF: cylinders of the wheels' links, distance of the wheels' joints"
        draft.fill("nominal.wheels", f"{{{value}}}", source, value)
    else:
        apart = urdf and _tried(lambda: wheel_distance_m(urdf, survey.wheels or {}, urdf.root))
        told = "" if not apart else f"; the URDF's wheel joints are {apart:.10g} m apart, radii are not in it"
        draft.ask(
            "nominal.wheels",
            f"measure the wheels with a ruler{told}",
            f"{inner}wheels: {{radius_left_m: {TODO}, radius_right_m: {TODO}, separation_m: {apart or TODO}}}",
            needed=False,
            indent=indent,
        )
    if drawn.T_h_reference is not None:
        value = _entries(pose_settings(drawn.T_h_reference))
        source = "URDF: fixed joints from the head to the camera's frame"
        draft.fill("nominal.head_eye", f"{{{value}}}", source, value)
    else:
        draft.ask(
            "nominal.head_eye",
            "pose of the camera's optical frame in the head frame, by a ruler; only needed if the motion does not show "
            "it",
            f"{inner}head_eye: {HeadEyeNominal.example}",
            needed=False,
            indent=indent,
        )
