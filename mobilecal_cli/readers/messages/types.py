"""Message types that the readers know: one row of `TYPES` each. All other types are read by their own fields."""

from __future__ import annotations

import base64
import binascii
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, Literal, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.signals import CAMERA_INFO, IMAGES, JOINT_STATE, STRING

Payload = bytes | memoryview
#: A decoded message: an object with the fields of its definition, which is the recording's, known at run time.
Decoded: TypeAlias = Any
Decoder = Callable[[Payload], Decoded]
DefinitionFormat = Literal["msg", "idl", "protobuf", ""]
#: Language of a definition as containers name it → its format.
LANGUAGES: dict[str, DefinitionFormat] = {
    "ros1msg": "msg",
    "ros2msg": "msg",
    "ros2idl": "idl",
    "omgidl": "idl",
    "protobuf": "protobuf",
}


def fields_of(message: Decoded) -> dict[str, Any]:
    """Name → value of an object's fields."""
    if isinstance(message, SimpleNamespace):
        return vars(message)
    names = getattr(message, "__dataclass_fields__", {})
    return {name: getattr(message, name) for name in names if not name.startswith("__")}


def leaves_of(message: Decoded, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of all fields of a message and of the messages in it."""
    for name, inner in fields_of(message).items():
        if fields_of(inner):
            yield from leaves_of(inner, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", inner


def _header(message: Decoded) -> dict[str, Any]:
    """A header, if the message has a `timestamp` instead."""
    stamp = getattr(message, "timestamp", None)
    nanosec = getattr(stamp, "nanosec", getattr(stamp, "nsec", None))
    if nanosec is None or hasattr(message, "header"):
        return {}
    frame_id = getattr(message, "frame_id", "")
    stamp = SimpleNamespace(sec=stamp.sec, nanosec=nanosec)  # type: ignore[union-attr]
    return {"header": SimpleNamespace(stamp=stamp, frame_id=frame_id)}


def _image(message: Decoded) -> dict[str, Any]:
    """Of a foxglove image; JSON encodes its bytes in base64."""
    header = _header(message)
    if not header:
        return {}
    try:
        data = (
            base64.b64decode(message.data, validate=True) if isinstance(message.data, str) else message.data
        )
    except binascii.Error as error:
        raise ValueError(f"data is not base64: {error}") from error
    return {**header, "is_bigendian": 0, "data": data}


def _camera_info(message: Decoded) -> dict[str, Any]:
    """Of a foxglove calibration, which is of whole images."""
    header, roi = _header(message), SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    return {**header, "roi": roi, "binning_x": 0, "binning_y": 0} if header else {}


def _interfaces(message: Decoded) -> dict[str, Any]:
    """Positions and velocities of a DynamicJointState; NaN if a joint has none."""
    values_of: dict[str, list[float]] = {"position": [], "velocity": []}
    for joint in message.interface_values:
        values = dict(zip(joint.interface_names, joint.values, strict=False))
        for kind, numbers in values_of.items():
            numbers.append(float(values.get(kind, math.nan)))
    known = {kind: numbers for kind, numbers in values_of.items() if not all(map(math.isnan, numbers))}
    return {"name": list(message.joint_names), **known}


def _controlled(message: Decoded) -> dict[str, Any]:
    """The measured state of a trajectory controller; older versions call it actual."""
    state: Any = getattr(message, "feedback", None) or message.actual
    return {"name": list(message.joint_names), "position": state.positions, "velocity": state.velocities}


@dataclass(frozen=True, slots=True)
class MessageType:
    """What the readers know of a message type.

    Attributes:
        definition: of a type beyond the ROS core, for recordings that store none.
        read_as: ROS type that says the same; "" for the type itself.
        any_package: the same message is in several packages.
        convert: a message → the fields of `read_as` that it lacks or spells differently.
    """

    definition: str = ""
    read_as: str = ""
    any_package: bool = False
    convert: Callable[[Decoded], dict[str, Any]] = _header


TYPES = {
    CAMERA_INFO: MessageType(convert=_camera_info),
    **dict.fromkeys(IMAGES, MessageType(convert=_image)),
    "foxglove/RawImage": MessageType(read_as=IMAGES[0], convert=_image),
    "foxglove/CompressedImage": MessageType(read_as=IMAGES[1], convert=_image),
    "foxglove/CompressedVideo": MessageType(read_as=IMAGES[1], convert=_image),
    "foxglove/CameraCalibration": MessageType(read_as=CAMERA_INFO, convert=_camera_info),
    "control_msgs/msg/InterfaceValue": MessageType(definition="string[] interface_names\nfloat64[] values"),
    "control_msgs/msg/DynamicJointState": MessageType(
        definition="std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values",
        read_as=JOINT_STATE,
        any_package=True,
        convert=_interfaces,
    ),
    "control_msgs/msg/JointTrajectoryControllerState": MessageType(
        read_as=JOINT_STATE, any_package=True, convert=_controlled
    ),
}
#: Types of the ROS core, the same in every ROS 1, and in every ROS 2: a stored definition that differs is damaged.
CORE = (
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    STRING,
    "sensor_msgs/msg/RegionOfInterest",
    CAMERA_INFO,
    *IMAGES,
    JOINT_STATE,
)
#: Each encoding spells dots and slashes differently.
_FOXGLOVE = re.compile(r"(?:foxglove(?:_msgs)?\.|foxglove/|foxglove_msgs/msg/)(\w+)")


def _known(name: str) -> tuple[str, MessageType]:
    """A type's name in ROS 2 spelling, and its row.

    Bridges to protobuf and JSON write "sensor_msgs.JointState" and "sensor_msgs.msg.JointState".
    """
    foxglove = _FOXGLOVE.fullmatch(name)
    if foxglove and f"foxglove/{foxglove[1]}" in TYPES:
        return name, TYPES[f"foxglove/{foxglove[1]}"]
    package, _, rest = name.replace(".", "/").partition("/")
    spelled = f"{package}/msg/{rest.removeprefix('msg/')}" if package.endswith("_msgs") and rest else name
    same = (r for key, r in TYPES.items() if r.any_package and spelled.endswith(key.rpartition("/")[2]))
    return spelled, TYPES.get(spelled) or next(same, MessageType())


def ros_type(name: str) -> str:
    """The ROS type that is equivalent to a type; most types are returned unchanged."""
    spelled, row = _known(name)
    return row.read_as or spelled


def like_ros(decode: Decoder, type_name: str) -> Decoder:
    """A decoder whose messages have the fields of the equivalent ROS type, and a header if they have a `timestamp`."""
    convert = _known(type_name)[1].convert

    def converted(payload: Payload) -> Decoded:
        message = decode(payload)
        more = convert(message)
        return SimpleNamespace(**{**fields_of(message), **more}) if more else message

    return converted


#: The largest messages of MoveIt and Autoware have a third of this; the time to create a decoder grows with it.
_MOST_FIELDS = 2000
_MOST_INSIDE = 100_000
#: Cost of a type in addition to its fields, in fields.
_FIELDS_A_TYPE = 10
_COMMENT = re.compile(r"#.*|//.*")
_MESSAGE_LIST = re.compile(r"[A-Za-z]\w*(?:/|::)\w+\s*(?:\w+\s*)?\[(?:<=)?(\d+)\]")
#: Two lines of this precede each file in concatenated IDL definitions.
_IDL_SEPARATOR = "=" * 80 + "\n"


def ros_decoder(
    encoding: str, type_name: str, definition: str, definition_format: DefinitionFormat
) -> Decoder:
    """Decoder of the messages of a type, by its stored definition or that of the common types.

    Raises:
        RecordingError: the definition is harmful, or there is none.
    """
    store = _embedded_types(encoding, type_name, definition, definition_format) or _default_types(encoding)
    if type_name not in store.fielddefs:
        raise RecordingError(
            f"the recording contains no definition of the message type {type_name}, "
            "and it is not one of the common types",
            "record in a format that stores definitions (MCAP, or rosbag2 since Iron)",
        )
    if encoding == "ros1":
        return lambda payload: store.deserialize_ros1(payload, type_name)
    return lambda payload: store.deserialize_cdr(payload, type_name)


def _embedded_types(
    encoding: str, type_name: str, definition: str, definition_format: DefinitionFormat
) -> Typestore | None:
    """Types declared in a definition text; None if none can be used."""
    if not definition.strip() or not definition_format:
        return None
    if _cost(definition) > _MOST_FIELDS:
        raise RecordingError(
            f"the definition of the message type {type_name} has {_cost(definition)} or more fields "
            f"(limit {_MOST_FIELDS})",
            "record the topic with its original definition, or do not record it",
        )
    try:
        if definition_format == "msg":
            types = get_types_from_msg(definition, type_name)
        elif definition.startswith(f"{_IDL_SEPARATOR}IDL: "):
            types = {}
            for part in definition.split(_IDL_SEPARATOR)[1:]:
                types.update(get_types_from_idl(part.partition("\n")[2]))
        else:
            types = get_types_from_idl(definition)
        types.update({name: _default_types(encoding).fielddefs[name] for name in CORE if name in types})
        _check_growth(types)
        store = get_typestore(Stores.EMPTY)
        store.register(types)
        store.get_msgdef(type_name)
    except RecordingError:
        raise
    except Exception:  # a damaged definition: the common types may suffice
        return None
    return store


def _cost(definition: str) -> int:
    """Approximate number of fields to create a decoder for; a list of fixed length counts once per element.

    Only lists of messages count this way, because numbers are read in one step.
    """
    plain = _COMMENT.sub("", definition)
    lengths = (int(length[:9]) for length in _MESSAGE_LIST.findall(plain))
    types = plain.count("MSG:") + plain.count("struct ")
    return sum(1 for line in plain.splitlines() if line.strip()) + sum(lengths) + _FIELDS_A_TYPE * types


def _check_growth(types: Mapping[str, Any]) -> None:
    """Check that a few bytes cannot expand to an unlimited number of messages.

    Raises:
        RecordingError: a type contains millions of others, or a list of messages that occupy no bytes.
        RecursionError: a type contains itself.
    """
    sizes: dict[str, tuple[float, bool]] = {}

    def size(name: str) -> tuple[float, bool]:
        """Number of messages inside, itself included, and whether the type occupies any bytes."""
        if name not in types or name in sizes:
            return sizes.get(name, (1.0, True))
        inside, weighs = 1.0, False
        for _, (kind, what) in types[name][1]:
            length, (inner_kind, inner) = 1, (kind, what)
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                (inner_kind, inner), length = what
            if inner_kind == Nodetype.BASE:
                weighs = True
                continue
            count, heavy = size(inner)
            if kind == Nodetype.SEQUENCE:
                inside, weighs = inside if heavy else math.inf, True
                continue
            inside, weighs = inside + count * length, weighs or heavy
        if inside > _MOST_INSIDE:
            raise RecordingError(
                f"the definition of the message type {name} expands a few bytes to millions of messages",
                "record the topic with its original definition, or do not record it",
            )
        sizes[name] = inside, weighs
        return sizes[name]

    for name in types:
        size(name)


@lru_cache(maxsize=2)
def _default_types(encoding: str) -> Typestore:
    """The common types. rosbag2 stores definitions since Iron, so files without them are older."""
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    for name, row in TYPES.items():
        if row.definition:
            store.register(get_types_from_msg(row.definition, name))
    return store
