"""Message definitions of ROS: the recording's own, or those of the common types."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers.messages.equivalents import Decoder

DefinitionFormat = Literal["msg", "idl", "protobuf", ""]

#: The largest messages of MoveIt and Autoware have a third of this; the time to create a decoder grows with it.
_MOST_FIELDS = 2000
_MOST_INSIDE = 100_000
#: Cost of a type in addition to its fields, in fields.
_FIELDS_A_TYPE = 10
_COMMENT = re.compile(r"#.*|//.*")
_MESSAGE_LIST = re.compile(r"[A-Za-z]\w*(?:/|::)\w+\s*(?:\w+\s*)?\[(?:<=)?(\d+)\]")
#: Two lines of this precede each file in concatenated IDL definitions.
_IDL_SEPARATOR = "=" * 80 + "\n"

#: Types whose fields the readers use by name; they are the same in every ROS 1, and in every ROS 2. Listed here,
#: because rosbags loads the types of five releases to get them, which takes longer than all other imports.
_RELIED_ON = {
    "builtin_interfaces/msg/Time": "sec:int32 nanosec:uint32",
    "sensor_msgs/msg/CameraInfo": (
        "header:std_msgs/msg/Header height:uint32 width:uint32 distortion_model:string d:float64[] k:float64[9] "
        "r:float64[9] p:float64[12] binning_x:uint32 binning_y:uint32 roi:sensor_msgs/msg/RegionOfInterest"
    ),
    "sensor_msgs/msg/CompressedImage": "header:std_msgs/msg/Header format:string data:uint8[]",
    "sensor_msgs/msg/Image": (
        "header:std_msgs/msg/Header height:uint32 width:uint32 encoding:string is_bigendian:uint8 step:uint32 "
        "data:uint8[]"
    ),
    "sensor_msgs/msg/JointState": (
        "header:std_msgs/msg/Header name:string[] position:float64[] velocity:float64[] effort:float64[]"
    ),
    "sensor_msgs/msg/RegionOfInterest": (
        "x_offset:uint32 y_offset:uint32 height:uint32 width:uint32 do_rectify:bool"
    ),
    "std_msgs/msg/Header": "stamp:builtin_interfaces/msg/Time frame_id:string",
    "std_msgs/msg/String": "data:string",
}
#: A common type that is in no release of the ROS core.
_CONTROL = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
    ),
}
_ROS1_HEADER = f"seq:uint32 {_RELIED_ON['std_msgs/msg/Header']}"


def ros_decoder(
    encoding: str, type_name: str, definition: str, definition_format: DefinitionFormat
) -> Decoder:
    """Decoder of the messages of a type, by its stored definition or that of the common types.

    Raises:
        RecordingError: the definition is harmful, or there is none.
    """
    store = _embedded_types(encoding, type_name, definition, definition_format)
    if store is None:
        store = _default_types(encoding)
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
        _check_growth(types)
        store = get_typestore(Stores.EMPTY)
        store.register(types)
        store.get_msgdef(type_name)
    except RecordingError:
        raise
    except Exception:  # a damaged definition: the common types may suffice
        return None
    return store if agrees(store, encoding) else None


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
    sizes: dict[str, tuple[int, bool]] = {}

    def size(name: str) -> tuple[int, bool]:
        """Number of messages inside, itself included, and whether the type occupies any bytes."""
        if name not in types or name in sizes:
            return sizes.get(name, (1, True))
        inside, weighs = 1, False
        for _, (kind, what) in types[name][1]:
            length, (inner_kind, inner) = 1, (kind, what)
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                (inner_kind, inner), length = what
            if inner_kind == Nodetype.BASE:
                weighs = True
                continue
            count, heavy = size(inner)
            if kind == Nodetype.SEQUENCE:
                if not heavy:
                    raise _endless(name)
                weighs = True
                continue
            inside, weighs = inside + count * length, weighs or heavy
        if inside > _MOST_INSIDE:
            raise _endless(name)
        sizes[name] = inside, weighs
        return sizes[name]

    for name in types:
        size(name)


def _endless(name: str) -> RecordingError:
    return RecordingError(
        f"the definition of the message type {name} expands a few bytes to millions of messages",
        "record the topic with its original definition, or do not record it",
    )


def agrees(store: Typestore, encoding: str) -> bool:
    """Whether the types used by the readers have their standard fields; if not, their definitions are damaged."""
    for name in _RELIED_ON.keys() & store.fielddefs.keys():
        common = _ROS1_HEADER if encoding == "ros1" and name == "std_msgs/msg/Header" else _RELIED_ON[name]
        if (
            " ".join(f"{_caseless(field)}:{_spelled(kind)}" for field, kind in store.fielddefs[name][1])
            != common
        ):
            return False
    return True


def _caseless(field: str) -> str:
    """A field name as in ROS 2: ROS 1 names a camera's matrices D, K, R, P, ROS 2 d, k, r, p."""
    return field.lower() if len(field) == 1 else field


def _spelled(field_type: Any) -> str:  # noqa: ANN401 - rosbags' nested tuples
    """A field's type as spelled in message definitions, such as float64[9] or string[]."""
    kind, what = field_type
    if kind == Nodetype.NAME:
        return str(what)
    of, bound = what
    if kind == Nodetype.BASE:
        return f"{of}<={bound}" if bound else str(of)
    length = f"<={bound}" if bound and kind == Nodetype.SEQUENCE else bound or ""
    return f"{_spelled(of)}[{length}]"


@lru_cache(maxsize=2)
def _default_types(encoding: str) -> Typestore:
    """The common types. rosbag2 stores definitions since Iron, so files without them are older."""
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    for name, definition in _CONTROL.items():
        store.register(get_types_from_msg(definition, name))
    return store
