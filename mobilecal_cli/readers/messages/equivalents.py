"""Messages in a common form: protobuf and JSON as objects, equivalent types as one ROS type."""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

#: Foxglove types that are equivalent to a ROS type; each encoding spells dots and slashes differently.
_FOXGLOVE = {
    "RawImage": "sensor_msgs/msg/Image",
    "CompressedImage": "sensor_msgs/msg/CompressedImage",
    "CompressedVideo": "sensor_msgs/msg/CompressedImage",
    "CameraCalibration": "sensor_msgs/msg/CameraInfo",
}
#: Messages of controllers with the state of joints; their packages differ.
_JOINT_STATES = ("DynamicJointState", "JointTrajectoryControllerState")
_PREFIXES = ("foxglove.", "foxglove_msgs.", "foxglove/", "foxglove_msgs/msg/")

Decoder = Callable[[bytes | memoryview], Any]


def ros_type(name: str) -> str:
    """The ROS type that is equivalent to a type; most types are returned unchanged.

    "foxglove.RawImage" is read as a sensor_msgs/msg/Image; "sensor_msgs.JointState" and "sensor_msgs.msg.JointState"
    (as bridges to protobuf and JSON spell them) as a sensor_msgs/msg/JointState, and so are controllers' states.
    """
    for prefix in _PREFIXES:
        if name.startswith(prefix) and name.removeprefix(prefix) in _FOXGLOVE:
            return _FOXGLOVE[name.removeprefix(prefix)]
    package, _, rest = name.replace(".", "/").partition("/")
    spelled = f"{package}/msg/{rest.removeprefix('msg/')}" if package.endswith("_msgs") and rest else name
    return "sensor_msgs/msg/JointState" if spelled.endswith(_JOINT_STATES) else spelled


def protobuf_decoder(definition: bytes, type_name: str) -> Decoder:
    """Decoder of messages of one type in a `FileDescriptorSet`.

    Raises:
        Exception: of any kind, if the set is damaged or lacks the type.
    """
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    files = descriptor_pb2.FileDescriptorSet.FromString(definition)
    pool = descriptor_pool.DescriptorPool()
    waiting = {file.name: file for file in files.file}
    while waiting:
        ready = [file for file in waiting.values() if not waiting.keys() & set(file.dependency)]
        if not ready:
            raise ValueError(f"circular dependencies between files: {', '.join(waiting)}")
        for file in ready:
            pool.Add(file)
            del waiting[file.name]
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(type_name))

    def decode(payload: bytes | memoryview) -> Any:  # noqa: ANN401 - the type is the recording's
        return _from_protobuf(kind.FromString(bytes(payload)))

    return decode


def _from_protobuf(message: Any) -> Any:  # noqa: ANN401
    if message.DESCRIPTOR.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        return SimpleNamespace(sec=message.seconds, nanosec=message.nanos)
    result = SimpleNamespace()
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            value = list(value) if field.is_repeated else value
        elif field.message_type.GetOptions().map_entry:
            value = None  # no reader uses a map
        elif field.is_repeated:
            value = [_from_protobuf(item) for item in value]
        else:
            value = _from_protobuf(value) if message.HasField(field.name) else None
        setattr(result, field.name, value)
    return result


def json_decoder() -> Decoder:
    """Decoder of JSON objects; NaN and Infinity are allowed."""

    def decode(payload: bytes | memoryview) -> Any:  # noqa: ANN401
        value = json.loads(bytes(payload), object_hook=lambda fields: SimpleNamespace(**fields))
        if not isinstance(value, SimpleNamespace):
            raise TypeError(f"expected a JSON object, got {type(value).__name__}")
        return value

    return decode


def like_ros(message: Any, type_name: str) -> Any:  # noqa: ANN401
    """The message with the fields of its equivalent ROS type, and a header if it has a `timestamp`."""
    if hasattr(message, "interface_values"):
        return _with(message, name=list(message.joint_names), **_interfaces(message.interface_values))
    # The measured state of a trajectory controller; older versions call it actual.
    state: Any = getattr(message, "feedback", None) or getattr(message, "actual", None)
    if hasattr(message, "joint_names") and hasattr(state, "positions"):
        names = list(message.joint_names)
        return _with(message, name=names, position=state.positions, velocity=state.velocities)
    stamp = getattr(message, "timestamp", None)
    if stamp is None or hasattr(message, "header"):
        return message
    nanosec = getattr(stamp, "nanosec", getattr(stamp, "nsec", None))
    if nanosec is None:
        return message
    stamp = SimpleNamespace(sec=stamp.sec, nanosec=nanosec)
    header = SimpleNamespace(stamp=stamp, frame_id=getattr(message, "frame_id", ""))
    meant = ros_type(type_name)
    if meant == "sensor_msgs/msg/CameraInfo":
        roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
        return _with(message, header=header, roi=roi, binning_x=0, binning_y=0)
    if meant in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"):
        return _with(message, header=header, is_bigendian=0, data=_bytes(message.data))
    return _with(message, header=header)


def _interfaces(joints: Any) -> dict[str, list[float]]:  # noqa: ANN401
    """Positions and velocities of a DynamicJointState; NaN if a joint has none."""
    found: dict[str, list[float]] = {"position": [], "velocity": []}
    for joint in joints:
        values = dict(zip(joint.interface_names, joint.values, strict=False))
        for kind, numbers in found.items():
            numbers.append(float(values.get(kind, math.nan)))
    return {kind: numbers for kind, numbers in found.items() if not all(map(math.isnan, numbers))}


def _with(message: Any, **more: Any) -> SimpleNamespace:  # noqa: ANN401
    return SimpleNamespace(**{**fields_of(message), **more})


def fields_of(message: Any) -> dict[str, Any]:  # noqa: ANN401
    """Name → value of an object's fields."""
    if isinstance(message, SimpleNamespace):
        return vars(message)
    names = getattr(message, "__dataclass_fields__", {})
    return {name: getattr(message, name) for name in names if not name.startswith("__")}


def _bytes(data: Any) -> Any:  # noqa: ANN401
    """Bytes of an image; JSON encodes them in base64."""
    if not isinstance(data, str):
        return data
    try:
        return base64.b64decode(data, validate=True)
    except binascii.Error as error:
        raise ValueError(f"data is not base64: {error}") from error
