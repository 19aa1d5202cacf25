"""Schema and checks of rig.yaml, and its combination with command-line flags. Unknown keys are errors."""

from __future__ import annotations

import difflib
import math
import re
import reprlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args, get_origin

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    Strict,
    ValidationError,
    model_validator,
)

from mobilecal_cli import ranges, se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.files.reading import LARGEST_BYTES, load_yaml, mapping_of, problem_of, read_text
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import (
    Board,
    FixedLink,
    JointLink,
    Markers,
    Nominal,
    Side,
    StereoLayout,
    WheelGeometry,
    WheelSource,
)
from mobilecal_cli.model.text import listed

#: Ten times the size of a URDF with thousands of links.
LARGEST_URDF_BYTES = 2**24

#: Value of a required key that a draft leaves to the user.
TODO = "TODO"


def _filled_in(value: object) -> object:
    if value == TODO:
        raise ValueError("not filled in yet")
    return value


Number = Annotated[float, Strict()]  # neither a text nor true
Finite = Annotated[Number, Field(allow_inf_nan=False)]
Radius = Annotated[Number, AfterValidator(ranges.WHEEL_RADIUS.validated)]
Separation = Annotated[Number, AfterValidator(ranges.WHEEL_SEPARATION.validated)]
Square = Annotated[Number, AfterValidator(ranges.SQUARE.validated)]
Ticks = Annotated[Number, AfterValidator(ranges.TICKS.validated)]
Sigma = Annotated[Number, AfterValidator(ranges.SIGMA.validated)]
Length = Annotated[Number, AfterValidator(ranges.POSITION.validated)]
Angle = Annotated[Number, AfterValidator(ranges.ANGLE.validated)]
Position = tuple[Length, Length, Length]
Text = Annotated[str, Field(min_length=1), BeforeValidator(_filled_in)]
#: A path; that in a file is relative to the directory of the file, which is the context of the check.
Beside = Annotated[
    Path, BeforeValidator(_filled_in), AfterValidator(lambda path, given: (given.context or Path()) / path)
]


class _Section(BaseModel):
    """A section of rig.yaml.

    Attributes:
        example: as YAML, where a draft leaves the section to the user; "" for none.
    """

    example: ClassVar[str] = ""
    model_config = ConfigDict(frozen=True, extra="forbid")


#: Marker dictionaries of OpenCV.
_DICTIONARIES = (
    *(f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    *(f"DICT_APRILTAG_{family}" for family in ("16h5", "25h9", "36h10", "36h11")),
)


def _known_dictionary(name: str) -> str:
    if name not in _DICTIONARIES:
        nearest = difflib.get_close_matches(name, _DICTIONARIES, n=3, cutoff=0.0)
        raise ValueError(f"not a marker dictionary of OpenCV, such as {', '.join(nearest)}")
    return name


Dictionary = Annotated[str, AfterValidator(_known_dictionary)]


class BoardConfig(_Section):
    """The board. Counts are inner corners (aprilgrid: tags)."""

    example: ClassVar[str] = "columns: 9\nrows: 6\nsquare_m: 0.08"

    kind: Literal["checkerboard", "charuco", "aprilgrid"] = "checkerboard"
    columns: int | None = Field(None, ge=2, le=100, description="inner corners (tags) along a row")
    rows: int | None = Field(None, ge=2, le=100, description="inner corners (tags) along a column")
    square_m: Square | None = Field(
        None,
        description="side of a square (of a tag), m; measured by the stereo pair if not given, needed without one",
    )
    dictionary: Dictionary | None = Field(None, description="marker dictionary, by its name in OpenCV")
    marker_share: float | None = Field(None, gt=0.1, lt=1, description="charuco: marker side / square side")
    gap_share: float | None = Field(None, ge=0, le=2, description="aprilgrid: gap between tags / tag side")
    first_id: int = Field(0, ge=0, le=10_000, description="id of the first marker")
    border_bits: int = Field(1, ge=1, le=3, description="width of the markers' black border, in cells")

    @model_validator(mode="after")
    def _consistent(self) -> BoardConfig:
        if self.kind == "checkerboard":
            for key in ("dictionary", "marker_share", "gap_share"):
                if getattr(self, key) is not None:
                    raise ValueError(
                        f"{key} applies only to boards with markers: set kind to charuco or aprilgrid"
                    )
            if (self.columns is None) != (self.rows is None):
                raise ValueError("give both columns and rows")
            if min(self.columns or 3, self.rows or 3) < 3:
                raise ValueError(
                    "3 or more columns and rows of inner corners are needed to find a checkerboard "
                    f"(got {self.columns} x {self.rows}): use a larger one"
                )
            return self
        needed = {"charuco": ("dictionary", "marker_share"), "aprilgrid": ("gap_share",)}[self.kind]
        missing = [key for key in ("columns", "rows", *needed) if getattr(self, key) is None]
        if missing:
            raise ValueError(f"a board of kind {self.kind} requires {listed(missing)}")
        return self

    @property
    def stated(self) -> Board | None:
        """The board, None if its size must be estimated from the images."""
        if not (self.columns and self.rows):
            return None
        markers = None
        if self.kind != "checkerboard":
            family = self.dictionary or "DICT_APRILTAG_36h11"
            share = self.marker_share if self.kind == "charuco" else self.gap_share
            markers = Markers(self.kind, family, share or 0.0, self.first_id, self.border_bits)
        return Board(self.columns, self.rows, self.square_m, markers)


class Pose(_Section):
    """A pose."""

    example: ClassVar[str] = "{translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}"

    translation_m: Position
    quaternion_xyzw: tuple[Finite, Finite, Finite, Finite]

    @model_validator(mode="after")
    def _unit_quaternion(self) -> Self:
        norm = math.hypot(*self.quaternion_xyzw)
        if abs(norm - 1) > 1e-3:
            raise ValueError(f"quaternion_xyzw has norm {norm:.6g} (must be 1)")
        return self

    @property
    def transform(self) -> FloatArray:
        """(4, 4), m."""
        rotation = se3.from_quaternion_xyzw(np.array(self.quaternion_xyzw))
        return se3.transform(rotation, np.array(self.translation_m))


class CameraTopics(_Section):
    """One camera's topics, and its pose in the frame of the first camera."""

    image: Text | None = None
    info: Text | None = None
    pose: Pose | None = Field(
        None,
        description="optical frame in that of the first camera, if neither camera_info nor a URDF states it",
    )


class BothInOneConfig(_Section):
    """Images of both cameras in one message: the left camera on the left, or on top."""

    image: Text
    layout: Literal["side_by_side", "stacked"] = "side_by_side"


class CamerasConfig(_Section):
    """A stereo pair (left and right, or both), or one or more cameras with other names, the first one first."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, CameraTopics] = Field(init=False)
    example: ClassVar[str] = (
        "left:  {image: /stereo/left/image_raw, info: /stereo/left/camera_info}\n"
        "right: {image: /stereo/right/image_raw, info: /stereo/right/camera_info}"
    )

    left: CameraTopics = CameraTopics()
    right: CameraTopics = CameraTopics()
    both: BothInOneConfig | None = None
    reference: Text | None = Field(
        None, description="camera of the head-eye transform; the first one (left) by default"
    )
    rectified: bool | None = None

    @property
    def each(self) -> dict[str, CameraTopics]:
        """What is configured of each camera: left and right, unless there are cameras with other names."""
        return self.__pydantic_extra__ or {"left": self.left, "right": self.right}

    @property
    def layout(self) -> StereoLayout:
        """Arrangement of the two images of a pair."""
        return "separate" if self.both is None else self.both.layout

    def of(self, name: str) -> CameraTopics:
        """What is configured of a camera, also of one that is found by names."""
        return self.each.get(name, CameraTopics())

    @model_validator(mode="after")
    def _both_or_each(self) -> CamerasConfig:
        if self.both is not None and (self.left.image or self.right.image):
            raise ValueError("give both.image, or left.image and right.image")
        named = self.__pydantic_extra__
        if named and (self.both or self.left.image or self.right.image):
            raise ValueError(
                f"give left and right (or both) for a stereo pair, or cameras with other names ({', '.join(named)})"
            )
        for name, topics in named.items():
            if not CAMERA_NAME.fullmatch(name):
                raise ValueError(
                    f"{name!r} cannot name a camera: lower-case letters, digits and _, not joints or wheels"
                )
            if topics.image is None:
                near = difflib.get_close_matches(name, CamerasConfig.model_fields, n=1, cutoff=0.7)
                raise ValueError(
                    f"{name} has no image topic" + (f"; did you mean {near[0]}?" if near else "")
                )
        if self.reference is not None and self.reference not in (named or ("left", "right", "camera")):
            known = ", ".join(named or ("left", "right"))
            raise ValueError(f"cameras.reference {self.reference!r} is not one of the cameras ({known})")
        return self


#: Not a part of the names of other constants of the robot.
CAMERA_NAME = re.compile(r"(?!(?:joints|wheels|left|right|both|aspect_.*)$)[a-z][a-z0-9_]{0,39}")


class JointFieldConfig(_Section):
    """Location of one joint's reading, in messages other than JointState."""

    example: ClassVar[str] = "{topic: /head, field: data, unit: rad}"

    topic: Text
    field: Text
    unit: Literal["rad", "deg", "m"] = "rad"


class JointsConfig(_Section):
    """The pan-tilt joints."""

    topic: Text | None = None
    pan: Text | None = None
    tilt: Text | None = None
    fields: dict[Text, JointFieldConfig] = Field(
        {}, description="joint → topic and field path of its reading"
    )


class WheelConfig(_Section):
    """Source of one side's rotation: one wheel, or several that are averaged."""

    topic: Text | None = None
    joint: Text | None = None
    joints: tuple[Text, ...] = Field((), description="several wheels of the side, which are averaged")
    field: Text | None = None
    fields: tuple[Text, ...] = Field((), description="several counters of the side, which are averaged")
    topics: tuple[Text, ...] = Field((), description="topic of each of fields, if not all are on topic")
    ticks_per_revolution: Ticks | None = None
    bits: int | None = Field(None, ge=4, le=64, description="width of a counter that wraps around")
    sign: Literal[1, -1] = 1
    signs: tuple[Literal[1, -1], ...] = Field((), description="sign of each of joints or fields")
    unread: tuple[Text, ...] | None = Field(
        None, description="joints of the side's wheels that are not read; those of the URDF by default"
    )

    @model_validator(mode="after")
    def _joint_or_field(self) -> WheelConfig:
        if sum(bool(given) for given in (self.joint, self.joints, self.field, self.fields)) > 1:
            raise ValueError("give only one of joint, joints, field and fields")
        if self.field is not None and self.topic is None:
            raise ValueError("field requires topic")
        if self.fields and (self.topic is None) == (not self.topics):
            raise ValueError("fields requires topic, or topics with one for each")
        several = self.joints or self.fields
        if len(set(zip(self.topics or several, several, strict=False))) < len(several):
            raise ValueError("the same wheel is named twice")
        for name in ("topics", "signs"):
            each = getattr(self, name)
            if each and len(each) != len(several):
                raise ValueError(f"{name} has {len(each)} entries for {len(several)} wheels")
        if self.bits is not None and self.ticks_per_revolution is None:
            raise ValueError("bits requires ticks_per_revolution")
        return self

    @property
    def side_joints(self) -> tuple[str, ...]:
        """Joints of all wheels of the side, those that are read first; none where counters are read."""
        read = tuple(wheel.joint for wheel in self.sources if wheel.joint)
        return (*read, *(self.unread or ())) if read else ()

    @property
    def sources(self) -> tuple[WheelSource, ...]:
        """The wheels of the side, each by itself, with a `joint` or a `field`; a topic that is not stated is ""."""
        joints = (self.joint,) if self.joint else self.joints
        names = joints or ((self.field,) if self.field else self.fields)
        topics = self.topics or (self.topic or "",) * len(names)
        signs = self.signs or (self.sign,) * len(names)
        count = self.ticks_per_revolution, self.bits
        return tuple(
            WheelSource(topic, name if joints else None, None if joints else name, *count, sign)
            for name, topic, sign in zip(names, topics, signs, strict=True)
        )


class WheelsConfig(_Section):
    """Sources of both wheels' rotation."""

    example: ClassVar[str] = (
        "left:  {topic: /ticks/left, field: data, ticks_per_revolution: 4096, bits: 16}\n"
        "right: {topic: /ticks/right, field: data, ticks_per_revolution: 4096, bits: 16}"
    )

    left: WheelConfig = WheelConfig()
    right: WheelConfig = WheelConfig()
    odometry: Text | None = Field(
        None, description="topic of a nav_msgs/Odometry, computed with nominal.wheels if these are given"
    )
    odometry_separation_m: Separation | None = Field(
        None,
        description="wheel separation in the driver that computes the odometry, if nominal.wheels are not given",
    )

    @property
    def of_sides(self) -> dict[Side, WheelConfig]:
        """The wheels of each side."""
        return {"left": self.left, "right": self.right}


class ChainLink(_Section):
    """One link: a fixed offset (xyz_m, rpy_rad) or a joint (joint, axis, kind)."""

    xyz_m: Position | None = None
    rpy_rad: tuple[Angle, Angle, Angle] | None = None
    joint: Text | None = None
    axis: tuple[Finite, Finite, Finite] | None = None
    kind: Literal["revolute", "prismatic"] = "revolute"

    @model_validator(mode="after")
    def _one_of_two(self) -> ChainLink:
        moving = self.joint is not None or self.axis is not None
        fixed = self.xyz_m is not None or self.rpy_rad is not None
        if moving == fixed:
            raise ValueError("a link is either {xyz_m, rpy_rad} or {joint, axis}")
        if moving and (self.joint is None or self.axis is None):
            raise ValueError("give both joint and axis")
        if self.axis is not None and math.hypot(*self.axis) < 1e-6:
            raise ValueError("axis has zero length")
        return self

    @property
    def stated(self) -> FixedLink | JointLink:
        """The link as a value."""
        if self.joint is not None and self.axis is not None:
            return JointLink(self.joint, np.array(self.axis) / math.hypot(*self.axis), self.kind)
        rotation = se3.from_rpy(np.array(self.rpy_rad or (0, 0, 0)))
        return FixedLink(se3.transform(rotation, np.array(self.xyz_m or (0, 0, 0))))


class HeadConfig(_Section):
    """Kinematic chain from base to head."""

    example: ClassVar[str] = """\
urdf: robot.urdf  # or the chain:
base_frame: base_link
head_frame: head_link
chain:
  - {xyz_m: [0.05, 0, 0.9], rpy_rad: [0, 0, 0]}
  - {joint: head_pan_joint, axis: [0, 0, 1]}
  - {xyz_m: [0.02, 0, 0.06]}
  - {joint: head_tilt_joint, axis: [0, 1, 0]}"""
    base_frame: Text | None = None
    head_frame: Text | None = None
    urdf: Beside | None = None
    chain: tuple[ChainLink, ...] | None = None

    @model_validator(mode="after")
    def _urdf_or_chain(self) -> HeadConfig:
        if self.urdf is not None and self.chain is not None:
            raise ValueError("give urdf or chain, not both")
        return self


class WheelsNominal(_Section):
    """Nominal wheels."""

    radius_left_m: Radius
    radius_right_m: Radius
    separation_m: Separation

    @property
    def geometry(self) -> WheelGeometry:
        """The wheels as the estimator has them."""
        return WheelGeometry(self.radius_right_m, self.radius_left_m, self.separation_m)


class NominalConfig(_Section):
    """Nominal values, used only for parameters that the recording does not determine."""

    head_eye: Pose | None = None
    wheels: WheelsNominal | None = None

    @property
    def stated(self) -> Nominal:
        """The nominal values; None where there are none."""
        return Nominal(
            None if self.head_eye is None else self.head_eye.transform,
            None if self.wheels is None else self.wheels.geometry,
        )


def _prior_entry(value: object) -> object:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if value in ("fixed", "free") or (number and (value == 0 or float(value) in ranges.SIGMA)):  # type: ignore[arg-type]
        return value
    raise ValueError(f"must be a standard deviation (0, or from {ranges.SIGMA}), fixed or free")


PriorEntry = float | Literal["fixed", "free"]


class NoiseConfig(_Section):
    """Known standard deviations; the others are estimated from the recording."""

    example: ClassVar[str] = "{pixel_px: 0.2, wheel_rad_per_sqrt_rad: 0.003, joint_rad: 0.001}"

    pixel_px: Sigma | None = Field(None, description="of one corner coordinate")
    wheel_rad_per_sqrt_rad: Sigma | None = Field(None, description="of a wheel over one radian")
    encoder_rad: Sigma | None = Field(None, description="of one encoder reading")
    joint_rad: Sigma | None = Field(None, description="of one joint reading")
    floor_rad: Sigma | None = Field(None, description="of the floor's roll and pitch under the base")
    floor_m: Sigma | None = Field(None, description="of the floor's height under the base")
    floor_length_m: Sigma | None = Field(None, description="distance over which the floor stays alike")
    sway_rad: Sigma | None = Field(None, description="of the base's roll and pitch beside the floor's")
    sway_m: Sigma | None = Field(None, description="of the base's height beside the floor's")
    stamp_s: Sigma | None = Field(None, description="of an image's stamp, in motion")
    pair_s: Sigma | None = Field(None, description="of the time between the images of two cameras, in motion")
    shift_px: Sigma | None = Field(None, description="of each image as a whole, with several cameras")
    wheel_share: Sigma | None = Field(None, description="of a wheel's scale")
    wheel_length_m: Sigma | None = Field(None, description="distance over which a wheel's scale stays alike")


class RigConfig(_Section):
    """All of rig.yaml. Every key is optional if the recording contains the information."""

    schema_version: Literal[1] = 1
    board: BoardConfig = BoardConfig()
    cameras: CamerasConfig = CamerasConfig()
    joints: JointsConfig = JointsConfig()
    wheels: WheelsConfig = WheelsConfig()
    head: HeadConfig = HeadConfig()
    nominal: NominalConfig = NominalConfig()
    noise: NoiseConfig = NoiseConfig()
    priors: dict[Text, Annotated[PriorEntry, BeforeValidator(_prior_entry)]] = Field(
        {},
        description="kind or name of a constant, or all → standard deviation of the stated value, fixed or free",
    )
    gates: dict[Text, Finite] = Field({}, description="metric → limit, as for --gate")
    stations: Literal["auto", "all"] = Field(
        "auto",
        description="auto: rests, or keyframes if the robot does not rest; all: every image, including those in motion",
    )
    _path: Path | None = PrivateAttr(None)
    _flags: tuple[str, ...] = PrivateAttr(())

    @property
    def path(self) -> Path | None:
        """The file that it was read from."""
        return self._path

    @property
    def flags(self) -> tuple[str, ...]:
        """Dotted keys that flags gave, in their order."""
        return self._flags

    def source_of(self, key: str) -> Literal["flag", "file"] | None:
        """What gave a dotted key or a key below it."""
        if any(is_in(flag, key) for flag in self._flags):
            return "flag"
        value: object = self
        for part in key.split("."):
            if part not in getattr(value, "model_fields_set", ()):
                return None
            value = getattr(value, part)
        return "file"


def is_in(key: str, section: str) -> bool:
    """Whether a dotted key is a key or is below it."""
    return f"{key}.".startswith(f"{section}.")


#: Everything is left to the recording and the defaults.
UNCONFIGURED = RigConfig()


def load_rig(path: Path | None, flags: Mapping[str, Any] | None = None) -> RigConfig:
    """Read rig.yaml and override it with flags.

    Args:
        path: the file; None if there is none.
        flags: dotted key → value, e.g. ``{"board.columns": 9}``; None values are ignored.

    Raises:
        ConfigError: the file cannot be read, is not YAML, or has an unknown key or a bad value.
    """
    data: dict[str, Any] = {}
    if path is not None:
        hint = "check the path of the configuration; check takes it first: mobilecal check rig.yaml LOG"
        text = read_text(path, LARGEST_BYTES, hint, "rig.yaml")
        data = mapping_of(text, str(path), "compare with the draft that mobilecal init LOG writes")
        if {"head_eye", "provenance"} <= data.keys():
            raise ConfigError(
                f"{path}: a params.yaml, the result of a calibration; a rig.yaml is expected, the configuration",
                "give the rig.yaml of this robot, or draft one with mobilecal init LOG; calibrate --last compares with "
                "an earlier result",
            )
    given = {key: value for key, value in (flags or {}).items() if value is not None}
    for key, value in given.items():
        section, _, name = key.partition(".")  # names of gates contain dots
        _assign(data, [section, name] if section == "gates" and name else key.split("."), value)
    rig = _validated(data, "" if path is None else f"{path}: ", given, path and path.parent)
    rig._path, rig._flags = path, tuple(given)
    return rig


def checked_settings(settings: Mapping[str, Any], where: str) -> RigConfig:
    """The settings of a result as a configuration, checked like those of rig.yaml; `where` is for messages.

    They are nested as in rig.yaml; keys that rig.yaml does not have are ignored.

    Raises:
        ConfigError: a value is not possible.
    """
    return _validated(_known(settings, RigConfig), where)


def _known(data: Mapping[str, Any], section: type[BaseModel]) -> dict[str, Any]:
    """The keys of a section that rig.yaml has too, without empty texts and measured values."""
    known = {}
    measured = {"square_m"} if data.get("square_from", "stated") != "stated" else set()
    for name, value in data.items():
        inner = _section_below(section, name)
        if inner is not None and isinstance(value, Mapping):
            known[name] = _known(value, inner)
        elif name in section.model_fields.keys() - measured and value != "":
            known[name] = value
    return known


def _section_below(section: type[BaseModel], name: str, inside: bool = False) -> type[BaseModel] | None:
    """The section of a key of a section; None for a key with a value. `inside` as for `_section_of`."""
    field = section.model_fields.get(name)
    if field is None:
        return CameraTopics if section is CamerasConfig else None
    return _section_of(field.annotation, inside)


def _section_of(annotation: Any, inside: bool = False) -> type[BaseModel] | None:  # noqa: ANN401
    """The section that a field holds, also where it may be None, and if asked `inside` a list or a mapping."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (dict, tuple) and not inside:
        return None
    return next(filter(None, (_section_of(each, inside) for each in get_args(annotation))), None)


def parse_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Dotted keys, and values read as YAML, of `--set KEY=VALUE`.

    Raises:
        ConfigError: no "=", a value that is empty or not YAML, or a key that is given twice.
    """
    settings: dict[str, Any] = {}
    for text in texts:
        key, _, written = text.partition("=")
        try:
            value = load_yaml(written)
        except ValueError as error:
            raise ConfigError(f"--set {text}: the value is not valid YAML", "quote the value") from error
        if not key or value is None:
            example = "write KEY=VALUE, for example --set wheels.left.sign=-1; leave it out for the default"
            raise ConfigError(f"--set {text}: not KEY=VALUE", example)
        if key in settings:
            raise ConfigError(f"--set {key}: given twice, as {settings[key]!r} and {value!r}", "give it once")
        settings[key] = value
    return settings


def read_urdf(config: RigConfig) -> str | None:
    """Text of `head.urdf`, None if the configuration names none.

    Raises:
        ConfigError: the file cannot be read.
    """
    urdf = config.head.urdf
    return (
        None if urdf is None else read_text(urdf, LARGEST_URDF_BYTES, "check the path of head.urdf", "URDF")
    )


def _assign(data: dict[str, Any], keys: list[str], value: object) -> None:
    for key in keys[:-1]:
        inner = data.setdefault(key, {})
        if not isinstance(inner, dict):
            raise ConfigError(
                f"{key}: a value in the file, not a section",
                "compare with the draft that mobilecal init LOG writes",
            )
        data = inner
    data[keys[-1]] = value


def setting_keys(section: type[BaseModel] = RigConfig, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted keys of rig.yaml that hold a value, with their descriptions ("" if there is none)."""
    for name, field in section.model_fields.items():
        if (inner := _section_of(field.annotation)) is not None:
            yield from setting_keys(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", field.description or ""


def _known_keys(location: tuple[int | str, ...]) -> list[str]:
    """Keys of the schema in the section at a location."""
    section: type[BaseModel] = RigConfig
    for part in location:  # or a number, or a key of a mapping, such as a joint's name
        section = _section_below(section, str(part), inside=True) or section
    return list(section.model_fields)


#: Types of pydantic's errors for a value in place of a section.
_NOT_A_SECTION = ("model_type", "dict_type")


def _validated(
    data: Mapping[str, Any], where: str, given: Collection[str] = (), folder: Path | None = None
) -> RigConfig:
    """The configuration, with paths relative to a folder.

    Raises:
        ConfigError: with the keys in question and what to write; `where` comes first, unless all of them are given as
            options.
    """
    try:
        return RigConfig.model_validate(data, context=folder)
    except ValidationError as error:
        items, cause = error.errors(), error
    todo = sorted({".".join(map(str, item["loc"])) for item in items if repr(item["input"]) == repr(TODO)})
    if todo:
        raise ConfigError(
            f"{where}not filled in yet: {', '.join(todo)}",
            f"replace each {TODO} by its value; the comments of the draft explain them",
        ) from cause
    problems, hints, of_options = [], [], []
    for item in items:
        key, location = ".".join(map(str, item["loc"])), item["loc"]
        of_options.append(any(is_in(key, option) for option in given))
        if item["type"] == "extra_forbidden":
            known = _known_keys(location[:-1])
            near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
            problems.append(f"{key}: unknown key")
            hints.append(f"did you mean {near[0]}?" if near else f"known keys: {', '.join(known)}")
        elif item["type"] in _NOT_A_SECTION:
            problems.append(f"{key}: a section of keys, not a value (got {reprlib.repr(item['input'])})")
            names = [] if item["type"] == "dict_type" else _known_keys(location)
            all_priors = key == "priors" and item["input"] is not None
            first, value = ("all", item["input"]) if all_priors else ([*names, "NAME"][0], "VALUE")
            example = f"{key}.{first}={value}" if of_options[-1] else f"{location[-1]}: {{{first}: {value}}}"
            hints.append(f"write {example}" + (f"; keys: {', '.join(names)}" if len(names) > 1 else ""))
        else:
            problems.append(problem_of(item))
    hint = "; ".join(dict.fromkeys(hints)) or "see docs/reference/rig-yaml.md for all keys"
    raise ConfigError(("" if all(of_options) else where) + "; ".join(problems), hint) from cause
