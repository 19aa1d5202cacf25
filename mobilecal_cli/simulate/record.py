"""Messages of the simulated robot; its recording in every container and the ground truth, written once complete."""

from __future__ import annotations

import heapq
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.errors import OutputError
from mobilecal_cli.export.outputs import (
    check_output,
    files_in,
    recognized_file,
    regular_file,
    write_all,
    write_synced,
)
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.rig import CameraInfo, WheelGeometry
from mobilecal_cli.simulate.robot import JOINT_NOISE_RAD, TICK_BITS, TICKS_PER_REVOLUTION, urdf_text
from mobilecal_cli.simulate.scenario import PIXEL_NOISE_GREY, Scenario, World
from mobilecal_cli.targets import Container

START_NS = 1_700_000_000_000_000_000  # begin of each recording, since 1970
_JPEG_QUALITY = 92  # percent, as of usual drivers
_OWN_SLIP = 0.001  # of one of several wheels of a side, rad per sqrt(rad)
_COUNTER_START_BELOW_WRAP = 500  # every counter wraps within a recording
_IN_ROSBAG2 = (".db3", ".mcap", ".db3-wal", ".db3-shm")


def nanoseconds(times_s: FloatArray) -> IntArray:
    """Header stamps for times of a recording, int64 ns."""
    return np.asarray(START_NS + np.round(np.asarray(times_s) * 1e9).astype(np.int64), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Published:
    """One message, not yet serialized.

    Attributes:
        time_ns: stamp and log time.
        topic, type: ROS topic, and type in ROS 2 spelling.
        fields: name → value, those that are not zero; dictionaries are the messages in it.
    """

    time_ns: int
    topic: str
    type: str
    fields: Mapping[str, Any]


def _serialized(published: Published, store: Typestore, ros1: bool) -> bytes:
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    return bytes(serialize(_made(published.type, published.fields, store), published.type))


def _made(kind: str, given: Mapping[str, Any], store: Typestore) -> Any:  # noqa: ANN401  (a generated class)
    fields: dict[str, Any] = {}
    definition: Any = store.fielddefs[kind][1]  # rosbags' nested tuples
    for name, (node, what) in definition:
        ros2_name = name.lower()  # ROS 1 has the matrices of a camera in upper case
        if node == Nodetype.NAME:
            fields[name] = _made(what, given.get(ros2_name, {}), store)
        else:
            fields[name] = given.get(ros2_name, 0 if node == Nodetype.BASE else np.zeros(what[1]))
    return store.types[kind](**fields)


def _header(time_ns: int, frame_id: str = "") -> dict[str, Any]:
    """Fields of std_msgs/Header."""
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame_id}


def _camera_info(info: CameraInfo, time_ns: int) -> dict[str, Any]:
    """Fields of sensor_msgs/CameraInfo."""
    return {
        "header": _header(time_ns, info.frame_id),
        "height": info.height,
        "width": info.width,
        "distortion_model": info.distortion,
        "d": info.D,
        "k": info.K.ravel(),
        "r": info.R.ravel(),
        "p": info.P.ravel(),
    }


def _odometry(pose: FloatArray, time_ns: int) -> dict[str, Any]:
    """Fields of nav_msgs/Odometry of a pose x, y (m), heading (rad), with a covariance that means nothing."""
    x, y, heading = (float(value) for value in pose)
    turned = {"z": float(np.sin(heading / 2)), "w": float(np.cos(heading / 2))}
    covariance = np.eye(6).ravel()
    return {
        "header": _header(time_ns, "odom"),
        "child_frame_id": "base_link",
        "pose": {"pose": {"position": {"x": x, "y": y}, "orientation": turned}, "covariance": covariance},
        "twist": {"covariance": covariance},
    }


def _picture(grey: FloatArray, frame_id: str, time_ns: int, scenario: Scenario) -> tuple[str, dict[str, Any]]:
    """8-bit image in the scenario's format: message type and fields."""
    image = np.clip(np.round(grey), 0, 255).astype(np.uint8)
    header = _header(time_ns, frame_id)
    if scenario.pictures == "mono8":
        height, width = image.shape
        size = {"height": height, "width": width, "step": width}
        return "sensor_msgs/msg/Image", {"header": header, "encoding": "mono8", "data": image.ravel(), **size}
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if scenario.pictures == "jpeg" else []
    ending = ".jpg" if scenario.pictures == "jpeg" else ".png"
    data = cv2.imencode(ending, image, options)[1].ravel()
    return "sensor_msgs/msg/CompressedImage", {"header": header, "format": scenario.pictures, "data": data}


def driver_odometry(wheels: FloatArray, nominal: WheelGeometry) -> FloatArray:
    """(n, 3) x, y and heading that a driver computes from wheel readings, (n, 2), with nominal wheels."""
    right, left = (np.diff(wheels, axis=0, prepend=wheels[:1]) * nominal.vector[:2]).T
    turn, run = (right - left) / nominal.separation_m, (right + left) / 2
    heading = np.cumsum(turn)
    chord = run * np.sinc(turn / (2 * np.pi))
    middle = heading - turn / 2
    return np.stack([np.cumsum(chord * np.cos(middle)), np.cumsum(chord * np.sin(middle)), heading], axis=1)


def _state_messages(world: World) -> Iterator[Published]:
    scenario, robot = world.scenario, world.robot
    random = np.random.default_rng([scenario.seed, 3])
    times_s = world.state_times_s()
    joints = world.joints(times_s)
    if not scenario.exact:
        joints = joints + JOINT_NOISE_RAD * random.normal(size=joints.shape)
    wheels = world.wheels(times_s, random)
    names = list(robot.joint_names)
    counters = robot.wheel_signal == "ticks"
    apart = counters or robot.wheel_signal == "odometry"
    names += [] if apart else [name for side in ("right", "left") for name in robot.wheel_joints[side]]
    each = len(robot.wheel_joints["left"])
    positions = np.repeat(wheels, each, axis=1)
    if each > 1 and not scenario.exact:
        positions = world.read(positions, _OWN_SLIP, np.random.default_rng([scenario.seed, 7]))
    odometry = driver_odometry(wheels, robot.nominal_wheels)
    for time_ns, head, wheel, rolled, pose in zip(
        nanoseconds(times_s), joints, wheels, positions, odometry, strict=True
    ):
        stamp = int(time_ns)
        position = head if apart else np.concatenate([head, rolled])
        state = {"header": _header(stamp), "name": names, "position": position}
        yield Published(stamp, "/joint_states", "sensor_msgs/msg/JointState", state)
        if robot.wheel_signal == "odometry":
            yield Published(stamp, "/odom", "nav_msgs/msg/Odometry", _odometry(pose, stamp))
        if counters:
            kind = f"std_msgs/msg/UInt{TICK_BITS}"
            for side, angle in (("right", wheel[0]), ("left", wheel[1])):
                ticks = int(np.round(angle * TICKS_PER_REVOLUTION / (2 * np.pi)))
                count = (2**TICK_BITS - _COUNTER_START_BELOW_WRAP + ticks) % 2**TICK_BITS
                yield Published(stamp, f"/wheel_ticks/{side}", kind, {"data": count})


def _picture_messages(world: World, drawn: Callable[[int, int], None]) -> Iterator[Published]:
    scenario, robot, rig = world.scenario, world.robot, world.cameras
    random = np.random.default_rng([scenario.seed, 4])
    renderers = world.renderers(random)
    times_s = world.picture_times_s()
    stamps = nanoseconds(world.stamps_s(times_s)).tolist()
    ending = "" if scenario.pictures == "mono8" else "/compressed"
    for i, T_w_c in enumerate(world.camera_poses(times_s)):
        stamp = stamps[i]
        for name, info, renderer, T_c_x in zip(rig.names, robot.infos, renderers, rig.T_c_each, strict=True):
            grey = renderer.picture(np.linalg.inv(T_w_c @ T_c_x) @ world.route.T_w_k)
            if not scenario.exact:
                grey = grey + PIXEL_NOISE_GREY * random.normal(size=grey.shape)
            kind, fields = _picture(grey, info.frame_id, stamp, scenario)
            topic, state = robot.camera_namespace(name), _camera_info(info, stamp)
            yield Published(stamp, f"{topic}/image_raw{ending}", kind, fields)
            yield Published(stamp, f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", state)
        drawn(i + 1, len(stamps))


def published(world: World, drawn: Callable[[int, int], None]) -> Iterator[Published]:
    """All messages of a recording in order of time, created lazily.

    Args:
        world: what to record.
        drawn: called with the number of rendered moments and their total.
    """
    description = {"data": urdf_text(world.robot)}
    return heapq.merge(
        [Published(START_NS, "/robot_description", "std_msgs/msg/String", description)],
        _state_messages(world),
        _picture_messages(world, drawn),
        key=lambda m: m.time_ns,
    )


def _mcap(
    compression: CompressionType, path: Path, messages: Iterable[Published], store: Typestore, ros1: bool
) -> None:
    profile, encoding = ("ros1", "ros1") if ros1 else ("ros2", "cdr")
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=compression)
        writer.start(profile=profile, library="mobilecal simulate")
        channels: dict[str, int] = {}
        for published in messages:
            if published.topic not in channels:
                definition, _ = store.generate_msgdef(published.type, ros_version=1 if ros1 else 2)
                name = published.type.replace("/msg/", "/") if ros1 else published.type
                schema = writer.register_schema(name, f"{profile}msg", definition.encode())
                channels[published.topic] = writer.register_channel(published.topic, encoding, schema)
            time_ns, data = published.time_ns, _serialized(published, store, ros1)
            writer.add_message(channels[published.topic], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


#: Containers of each kind of writer, and what they differ in.
_MCAP = {
    "mcap": CompressionType.NONE,
    "mcap-lz4": CompressionType.LZ4,
    "mcap-zstd": CompressionType.ZSTD,
    "mcap-ros1": CompressionType.NONE,
}
_ROSBAG2 = {"rosbag2": StoragePlugin.SQLITE3, "rosbag2-mcap": StoragePlugin.MCAP}
_BAG = {"bag-lz4": BagWriter.CompressionFormat.LZ4, "bag-bz2": BagWriter.CompressionFormat.BZ2}


def write(container: Container, path: Path, messages: Iterable[Published]) -> None:
    """Write messages, in order of time, as a recording."""
    ros1 = container.startswith("bag") or container == "mcap-ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if container in _MCAP:
        _mcap(_MCAP[container], path, messages, store, ros1)
        return
    writer: Any = BagWriter(path)
    if container in _ROSBAG2:
        writer = Rosbag2Writer(path, version=9, storage_plugin=_ROSBAG2[container])
    elif container in _BAG:
        writer.set_compression(_BAG[container])
    connections: dict[str, Any] = {}
    with writer:
        for published in messages:
            topic = published.topic
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, published.type, typestore=store)
            writer.write(connections[topic], published.time_ns, _serialized(published, store, ros1))


def truth_path(out: Path) -> Path:
    """Path of a recording's ground truth: `<name>.truth.yaml` in the same directory.

    Raises:
        OutputError: the recording has no name, as "." and "/".
    """
    if not out.name:
        raise OutputError(f"{out}: not the name of a recording", "choose another output path")
    return out.with_name(f"{out.stem if out.suffix in ('.mcap', '.bag') else out.name}.truth.yaml")


def simulate(
    scenario: Scenario,
    out: Path,
    force: bool = False,
    progress: Progress = silent,
    world_of: type[World] = World,
) -> Path:
    """Simulate a scenario and write its recording.

    Args:
        scenario: what to simulate.
        out: the recording: a file, or a directory for rosbag2.
        force: replace an existing recording.
        progress: called after every rendered stereo pair.
        world_of: the robot and the board as they are.

    Returns:
        Path of the ground truth.

    Raises:
        OutputError: the path already exists, or cannot be written.
        ConfigError: no route keeps the board in view.
    """
    truth = truth_path(out)
    recognized = recognized_folder if scenario.container in _ROSBAG2 else regular_file
    check_output(out, force, recognize=recognized)
    if os.path.lexists(out) and not truth.is_file():
        raise OutputError(
            f"{out}: not written by mobilecal simulate: there is no {truth.name}", "choose another name"
        )
    check_output(truth, force)
    world = world_of(scenario, *scenario.plan())
    messages = published(world, lambda done, total: progress("rendering images", done, total))

    def write_recording(path: Path) -> None:
        try:
            write(scenario.container, path, messages)
        except sqlite3.Error as error:
            raise OSError(str(error)) from error

    truth_of_it = (truth, recognized_file, lambda path: write_synced(path, world.truth().encode()))
    write_all([(out, recognized, write_recording), truth_of_it], force)
    return truth


def recognized_folder(folder: Path) -> tuple[str, ...]:
    """Names of the files in a rosbag2 directory.

    Raises:
        OutputError: it is not a directory, or contains something else.
    """
    return files_in(
        folder, "a recording", lambda path: path.name == "metadata.yaml" or path.suffix in _IN_ROSBAG2
    )
