"""Commented draft of rig.yaml: what a recording and a URDF tell, each with its source, and what is left to the user."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics.urdf import parse_urdf
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
    BoardConfig,
    CamerasConfig,
    HeadConfig,
    HeadEyeNominal,
    JointFieldConfig,
    NoiseConfig,
    RigConfig,
    WheelsConfig,
    WheelsNominal,
)
from mobilecal_cli.rig.joints import pan_and_tilt
from mobilecal_cli.rig.names import counters, joint_state_names, named_as, tick_counters
from mobilecal_cli.rig.resolve import Part, Survey, survey_rig
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


def _one_line(error: MobilecalError) -> str:
    said = f"{error.message}; {error.hint}" if error.hint else error.message
    return " ".join(said.split())


def _tried(step: Callable[[], T]) -> T | None:
    try:
        return step()
    except MobilecalError:
        return None


def _example(name: str, section: type[CamerasConfig | WheelsConfig | HeadConfig]) -> list[str]:
    return [f"{name}:", *(f"  {line}" for line in section.example.splitlines())]


def _listing(title: str, names: Iterable[str]) -> str:
    return f"# {title}: {listed([_quoted(name) for name in sorted(names)], _MOST_NAMES)}"


@dataclass
class _Page:
    """What is known of the robot (see `draft_rig`); the file as it is written; what is filled in and what is left."""

    description: RobotDescription
    survey: Survey
    urdf_text: str | None
    urdf_path: str | None
    board: BoardView | None
    lines: list[str] = field(default_factory=list)
    filled: list[Filled] = field(default_factory=list)
    todo: list[Todo] = field(default_factory=list)

    def add(self, *lines: str) -> None:
        self.lines += lines

    def fill(self, key: str, text: str, source: str, value: str | None = None) -> None:
        """A key of a section as YAML, with its source as a comment; and its value for the summary, if not the text."""
        self.filled.append(Filled(key, text if value is None else value, source))
        line = f"  {key.partition('.')[2]}: {text}"
        both = f"{line}  # {source}"
        self.lines += [both] if len(both) <= _WIDTH else [f"  # {source}", line]

    def ask(self, key: str, why: str, *template: str, needed: bool, indent: str = "") -> None:
        """A key that is left to the user, and lines to fill in."""
        self.todo.append(Todo(key, why, needed))
        said = textwrap.wrap(f"TODO {self.todo[-1]}", _WIDTH, break_long_words=False, break_on_hyphens=False)
        self.lines += [f"{indent}# {line}" for line in (*said, *template)]

    def ask_for(self, part: Part, key: str, *template: str, indent: str = "") -> None:
        """What the survey lacks of one part."""
        errors = [_one_line(error) for lack, error in self.survey.lacks if lack == part]
        for number, why in enumerate(errors):
            last = number == len(errors) - 1
            self.ask(key, why, *(template if last else ()), needed=True, indent=indent)


def draft_rig(
    description: RobotDescription,
    log_name: str,
    *,
    survey: Survey | None = None,
    urdf_text: str | None = None,
    urdf_path: str | None = None,
    board: BoardView | None = None,
) -> Draft:
    """Draft of a rig.yaml.

    Where names, images or readings allow two answers, the user is asked.

    Args:
        `description`: topics and first messages of the recording.
        log_name: shown in the first line.
        survey: of the recording without a configuration, if there is one already.
        urdf_text: text of the URDF to use in place of the one in the recording.
        urdf_path: its path, as it is written to the file.
        board: the board in some images.
    """
    survey = survey or survey_rig(RigConfig(), description, urdf_text)
    page = _Page(description, survey, urdf_text, urdf_path, board)
    page.add(
        f"# rig.yaml for mobilecal, drafted from {_quoted(log_name)}.",
        "# The comment of a value says where it comes from. Fill in or delete what is marked TODO, then test the file",
        "# with mobilecal check. Every key is optional if the recording contains the information.",
        "schema_version: 1",
        "",
    )
    for section in (_board, _cameras, _wheels, _joints, _head, _nominal):
        section(page)
        page.add("")
    page.add(
        "# known standard deviations; those omitted are estimated from the recording",
        f"# noise: {NoiseConfig.example}",
        "",
        *_accuracy(),
        "",
        *_priors(),
    )
    notes = () if survey.head is None else survey.head.notes
    # Names from the recording are also in the comments, where YAML allows no control characters.
    return Draft(
        "\n".join(visible(line) for line in page.lines) + "\n", tuple(page.filled), tuple(page.todo), notes
    )


def _board(page: _Page) -> None:
    board, template = page.board, f"board: {BoardConfig.example}"
    if board is None:
        page.add("# inner corners and squares of the board; no images to find it in", f"# {template}")
        return
    if board.size is None or board.seen < _ENOUGH_BOARDS or board.other_sizes:
        what = f"board of {board.size[0]} x {board.size[1]}" if board.size else "checkerboard of one size"
        others = f", {board.other_sizes} one of another size" if board.other_sizes else ""
        page.ask(
            "board",
            f"{board.seen} of {board.pictures} images show a whole {what}{others}; count the inner corners, or set "
            "kind for a board with markers",
            template,
            needed=board.size is None,
        )
        return
    columns, rows = board.size
    source = f"images: inner corners of the checkerboard, whole in {board.seen} of {board.pictures}"
    page.add("board:")
    page.fill("board.columns", str(columns), source)
    page.fill("board.rows", str(rows), source)
    _square(page, board)


def _square(page: _Page, board: BoardView) -> None:
    """The size of the squares is only suggested: the stereo baseline that it is measured with may be wrong."""
    images = page.survey.images
    if images is not None and tuple(images) != SIDES:
        page.add(
            "  # square_m: 0.08  # measured with a ruler: cameras that are no stereo pair do not show it"
        )
        return
    why = "measure ten squares with a ruler; until then, the stereo pair gives the scale"
    sides = board.squares_m
    if board.square_m is None or len(sides) < _ENOUGH_SQUARES or np.ptp(sides) > _SQUARE_SPREAD * min(sides):
        page.ask("board.square_m", why, "square_m: 0.08", needed=False, indent="  ")
        return
    measured = f"{board.square_m * 1e3:.2f} mm by {len(sides)} stereo pairs and the baseline in camera_info"
    likely = likely_square_m(board.square_m)
    suggested = likely if likely is not None else round(board.square_m, 4)
    kind = "a usual size" if likely is not None else "no usual size"
    page.ask(
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


def _cameras(page: _Page) -> None:
    images, infos = page.survey.images, page.survey.infos
    present = (topic.name for topic in page.description.topics if topic.type in IMAGES)
    page.add(_listing("image topics in the recording", present))
    if images is None:
        named = named_cameras(RigConfig(), page.description)
        several = ["cameras:", *(f"  {name}: {{image: {_quoted(topic)}}}" for name, topic in named.items())]
        page.ask_for("cameras", "cameras", *(several if named else _example("cameras", CamerasConfig)))
        return
    page.add("cameras:")
    for name, image in images.items():
        info = infos.get(name)
        value = image if info is None else f"{image}, {info}"
        entry = _flow({"image": image, "info": info})
        page.fill(f"cameras.{name}", entry, "recording: names and types of the topics", value)
    page.ask_for("camera infos", "cameras", indent="  ")
    page.add(f"  reference: {next(iter(images))}  # default: camera of the head-eye transform")
    rectified = "true" if page.survey.rectified else "false"
    page.fill("cameras.rectified", rectified, "name of the image topic")


def _wheels(page: _Page) -> None:
    page.add("# sign: -1 is for a wheel whose readings decrease when driving forward; a calibration names it")
    sources = page.survey.wheels
    if sources is not None and sources["left"].assumed:
        topic = sources["left"].topic
        page.add("wheels:")
        why = "recording: no wheels, and the only odometry that is named as theirs"
        page.fill("wheels.odometry", _quoted(topic), why, topic)
        page.add(
            "  # odometry_separation_m: 0.4  # wheel_separation in the driver; it only scales the difference of the",
            "  # multipliers of the left and right radius",
        )
        return
    if sources is not None:
        page.add("wheels:")
        for side in SIDES:
            _wheel(page, side, sources[side])
        return
    sets = counters(page.description.numbers)
    whole = tick_counters(sets)
    if len(sets) == 1 and whole:
        page.add("wheels:")
        for side in SIDES:
            _counter(page, side, whole[0][side])
        page.ask(
            "wheels.left.ticks_per_revolution, wheels.right.ticks_per_revolution",
            "counter steps per turn of the wheel: encoder steps times gear ratio; no recording contains them",
            needed=True,
            indent="  ",
        )
        return
    page.ask_for(
        "wheels",
        "wheels",
        *(
            f"candidate: {_described(number)}"
            for by_side in sets
            for side in SIDES
            for number in by_side[side]
        ),
        *_example("wheels", WheelsConfig),
    )
    odometry = [topic.name for topic in page.description.topics if topic.type == ODOMETRY]
    if odometry:
        page.add(f"# or: wheels: {{odometry: {_quoted(odometry[0])}}}")


def _wheel(page: _Page, side: Side, source: WheelSource) -> None:
    """The wheels of one side that the survey found."""
    parts = source.every
    where = ", ".join(f"{part.joint or part.field} on {part.topic}" for part in parts)
    if source.joint is not None:
        topic = source.topic if len({part.topic for part in parts}) == 1 else None
        joints = [part.joint for part in parts]
        several = {"joint": joints[0]} if len(parts) == 1 else {"joints": joints}
        kind = "pair of joints" if len(parts) == 1 else "set of joints"
        page.fill(
            f"wheels.{side}",
            _flow({"topic": topic, **several, "sign": source.sign}),
            f"recording: the only {kind} named as wheels",
            where,
        )
        return
    counted = {"ticks_per_revolution": source.ticks_per_revolution, "bits": source.bits}
    places = _fields([(part.topic, part.field or "") for part in parts])
    page.fill(f"wheels.{side}", _flow(places | counted), "recording: counters of a known driver", where)


def _fields(places: Sequence[tuple[str, str]]) -> dict[str, object]:
    """Topics and fields of counters, as in a `wheels.left`."""
    topics, paths = [topic for topic, _ in places], [path for _, path in places]
    if len(places) == 1:
        return {"topic": topics[0], "field": paths[0]}
    where: dict[str, object] = {"topic": topics[0]} if len(set(topics)) == 1 else {"topics": topics}
    return {**where, "fields": paths}


def _counter(page: _Page, side: Side, numbers: Sequence[NumberField]) -> None:
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
    page.fill(f"wheels.{side}", _flow(entry), source, shown + ("" if width is None else f", bits: {width}"))


def _described(number: NumberField) -> str:
    kind = "whole number" if number.integer else "number, unit unknown"
    jumps = "" if number.jump is None else f", jumps by {number.jump}"
    return f"topic {_quoted(number.topic)}, field {_quoted(number.path)} ({kind}{jumps})"


def _joints(page: _Page) -> None:
    survey, names = page.survey, joint_state_names(page.description)
    page.add(_listing("joints in the recording's joint states", names))
    if survey.head is not None:
        chain = survey.head.chain
        pan, tilt = chain.pan, chain.tilt
    else:
        pan, tilt = _tried(lambda: pan_and_tilt(RigConfig(), page.description, names)) or ("", "")
    only_topic = survey.joints and len(survey.joints) == 1 and not survey.elsewhere
    keys = {"topic": survey.joints[0]} if survey.joints and only_topic else {}
    keys |= {key: name for key, name in (("pan", pan), ("tilt", tilt)) if name}
    if keys:
        page.add("joints:")
    for key, value in keys.items():
        source = "recording: the only one with the head's joints" if key == "topic" else "name of the joint"
        page.fill(f"joints.{key}", _quoted(value), source, value)
    missing = () if survey.head is None else [n for n in survey.head.chain.joints if n not in names]
    named = [number for name in missing for number in named_as(name, page.description.numbers)]
    template = ["fields:", *(f"  {_quoted(name)}: {JointFieldConfig.example}" for name in missing)]
    if not keys:
        template = ["joints:", *(f"  {line}" for line in template)]
    candidates = (f"candidate: {_described(number)}" for number in named)
    page.ask_for("joints", "joints.fields", *candidates, *template, indent="  " if keys else "")


def _head(page: _Page) -> None:
    head, urdf_path = page.survey.head, page.urdf_path
    if head is None:
        page.ask_for("head chain", "head", *_example("head", HeadConfig))
        return
    chain, source = head.chain, "the given URDF" if urdf_path else head.origin
    page.add("head:")
    if urdf_path is not None:
        page.fill("head.urdf", _quoted(urdf_path), "option --urdf", urdf_path)
    page.fill("head.base_frame", _quoted(chain.base_frame), source, chain.base_frame)
    last = f"{source}: link of the last head joint"
    page.fill("head.head_frame", _quoted(chain.head_frame), last, chain.head_frame)
    page.add(
        f"  # joint positions, from the {source}: from the vehicle frame (midway between the wheels) to the head;",
        "  # to change them, delete the comment signs" + (" and the line urdf" if urdf_path else ""),
        "  # chain:",
        *(f"  #   - {link}" for link in _links(chain)),
    )
    page.ask_for("head chain", "head", indent="  ")


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


def _nominal(page: _Page) -> None:
    survey = page.survey
    text = page.urdf_text or next((text for _, text in sorted(page.description.urdfs.items())), None)
    urdf = None if text is None else _tried(lambda: parse_urdf(text))
    drawn = Nominal() if survey.head is None else survey.head.drawn
    if urdf is not None and drawn.wheels is None:
        drawn = replace(drawn, wheels=_tried(lambda: nominal_wheels(urdf, survey.wheels or {}, urdf.root)))
    page.add("# nominal values: for what the recording does not determine, and to unwrap large turns")
    filled = drawn.wheels is not None or drawn.T_h_reference is not None
    indent, inner = ("  ", "") if filled else ("", "  ")
    page.add("nominal:" if filled else "# nominal:")
    if drawn.wheels is not None:
        value = _entries({name: getattr(drawn.wheels, name) for name in WheelsNominal.model_fields})
        source = "URDF: cylinders of the wheels' links, distance of the wheels' joints"
        page.fill("nominal.wheels", f"{{{value}}}", source, value)
    else:
        apart = urdf and _tried(lambda: wheel_distance_m(urdf, survey.wheels or {}, urdf.root))
        told = "" if not apart else f"; the URDF's wheel joints are {apart:.10g} m apart, radii are not in it"
        page.ask(
            "nominal.wheels",
            f"measure the wheels with a ruler{told}",
            f"{inner}wheels: {{radius_left_m: {TODO}, radius_right_m: {TODO}, separation_m: {apart or TODO}}}",
            needed=False,
            indent=indent,
        )
    if drawn.T_h_reference is not None:
        value = _entries(pose_settings(drawn.T_h_reference))
        source = "URDF: fixed joints from the head to the camera's frame"
        page.fill("nominal.head_eye", f"{{{value}}}", source, value)
    else:
        page.ask(
            "nominal.head_eye",
            "pose of the camera's optical frame in the head frame, by a ruler; only needed if the motion does not show "
            "it",
            f"{inner}head_eye: {HeadEyeNominal.example}",
            needed=False,
            indent=indent,
        )


def _accuracy() -> list[str]:
    """The section `gates` with the default limits of the expected errors, as comments."""
    return [
        "# the accuracy that this robot needs (1 sigma; here the defaults): verdict, report and suggestions go by it",
        "# gates:",
        *(f"#   {name}: {limit:g}" for name, limit in ACCURACY.items()),
    ]


def _priors() -> list[str]:
    """The section `priors` with all defaults, as comments."""
    entries = [(f"#   {kind.name}: {kind.sigma * kind.shown:.4g}", kind) for kind in KINDS]
    width = max(len(entry) for entry, _ in entries)
    return [
        "# how well the stated constants of the robot are known: one standard deviation of each, fixed (exact) or free",
        "# (ignored). all: fixed makes every constant exact; an entry for a single constant, such as focal_left,",
        "# overrides that of its kind.",
        "# priors:",
        *(f"{entry:{width}}  # {kind.shown_unit}: {kind.meaning}" for entry, kind in entries),
    ]
