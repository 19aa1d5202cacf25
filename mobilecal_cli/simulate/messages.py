"""Messages published by the simulated robot, the same for every container."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from mobilecal_cli.model import CameraInfo, FloatArray, Side
from mobilecal_cli.simulate.drive import base_in_world
from mobilecal_cli.simulate.ideal import START_NS, nanoseconds
from mobilecal_cli.simulate.render import BoardRenderer
from mobilecal_cli.simulate.robot import SimulatedRobot
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.simulate.scenario import Scenario
from mobilecal_cli.simulate.urdf import urdf_text

Ros = Literal[1, 2]
_COUNTER_TYPES = {8: "UInt8", 16: "UInt16", 32: "UInt32", 64: "UInt64"}
_COUNTER_START_BELOW_WRAP = 500  # every counter wraps within a recording


@dataclass(frozen=True, slots=True)
class Published:
    """One message, not yet serialized."""

    time_ns: int
    topic: str
    type: str
    message: Any


class Publisher:
    """Creates messages for ROS 1 or ROS 2, which differ in field names only."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros
        self.store: Typestore = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        self._types = self.store.types

    def header(self, time_ns: int, frame_id: str = "") -> Any:  # noqa: ANN401  (a generated class)
        """std_msgs/Header."""
        stamp = self._types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        sequence: dict[str, Any] = {"seq": 0} if self.ros == 1 else {}
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **sequence)

    def make(self, kind: str, **fields: Any) -> Any:  # noqa: ANN401
        """Create a message of a given type."""
        return self._types[kind](**fields)

    def camera_info(self, info: CameraInfo, time_ns: int) -> Any:  # noqa: ANN401
        """sensor_msgs/CameraInfo; ROS 1 has matrix names in upper case."""
        matrices = {"d": info.D, "k": info.K.ravel(), "r": info.R.ravel(), "p": info.P.ravel()}
        named = {name.upper() if self.ros == 1 else name: value for name, value in matrices.items()}
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(time_ns, info.frame_id),
            height=info.height,
            width=info.width,
            distortion_model=info.distortion,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **named,
        )

    def picture(self, grey: FloatArray, frame_id: str, time_ns: int, scenario: Scenario) -> tuple[str, Any]:
        """8-bit image in the scenario's format: message type and message."""
        image = np.clip(np.round(grey), 0, 255).astype(np.uint8)
        header = self.header(time_ns, frame_id)
        if scenario.pictures == "mono8":
            height, width = image.shape
            kind = "sensor_msgs/msg/Image"
            fields: dict[str, Any] = {"height": height, "width": width, "encoding": "mono8"}
            fields |= {"is_bigendian": 0, "step": width, "data": image.ravel()}
            return kind, self.make(kind, header=header, **fields)
        kind = "sensor_msgs/msg/CompressedImage"
        options = [cv2.IMWRITE_JPEG_QUALITY, scenario.jpeg_quality] if scenario.pictures == "jpeg" else []
        ending = ".jpg" if scenario.pictures == "jpeg" else ".png"
        data = cv2.imencode(ending, image, options)[1].ravel()
        return kind, self.make(kind, header=header, format=scenario.pictures, data=data)


def _noisy_wheels(
    robot: SimulatedRobot, route: Route, times_s: FloatArray, scenario: Scenario, random: np.random.Generator
) -> FloatArray:
    """(n, 2) readings of the right and left encoder, rad."""
    angles = route.drive.wheel_angles(times_s, robot.wheels)
    if scenario.exact:
        return angles
    turned = np.abs(np.diff(angles, axis=0, prepend=angles[:1]))
    slip = random.normal(size=turned.shape) * scenario.wheel_noise_rad_per_sqrt_rad * np.sqrt(turned)
    return np.asarray(
        np.floor((angles + np.cumsum(slip, axis=0)) / robot.encoder_step_rad) * robot.encoder_step_rad
    )


def _state_messages(
    publisher: Publisher, robot: SimulatedRobot, route: Route, scenario: Scenario
) -> Iterator[Published]:
    random = np.random.default_rng([scenario.seed, 3])
    # Exact recordings also sample every change of speed, because the angles are linear in between.
    times_s = np.arange(0, route.duration_s, 1 / robot.joint_rate_hz)
    if scenario.exact:
        times_s = np.unique(np.concatenate([times_s, route.drive.breaks_s]))
    joints = route.joints(times_s)
    if not scenario.exact:
        joints = joints + robot.joint_noise_rad * random.normal(size=joints.shape)
    wheels = _noisy_wheels(robot, route, times_s, scenario, random)
    names = list(robot.joint_names)
    counters = robot.wheel_signal == "ticks"
    for time_ns, head, wheel in zip(nanoseconds(times_s), joints, wheels, strict=True):
        stamp = int(time_ns)
        yield Published(
            stamp,
            "/joint_states",
            "sensor_msgs/msg/JointState",
            publisher.make(
                "sensor_msgs/msg/JointState",
                header=publisher.header(stamp),
                name=names if counters else [*names, "wheel_right_joint", "wheel_left_joint"],
                position=head if counters else np.concatenate([head, wheel]),
                velocity=np.zeros(0),
                effort=np.zeros(0),
            ),
        )
        if counters:
            kind = f"std_msgs/msg/{_COUNTER_TYPES[robot.tick_bits]}"
            for side, angle in (("right", wheel[0]), ("left", wheel[1])):
                ticks = int(np.round(angle * robot.ticks_per_revolution / (2 * np.pi)))
                count = (2**robot.tick_bits - _COUNTER_START_BELOW_WRAP + ticks) % 2**robot.tick_bits
                yield Published(stamp, f"/wheel_ticks/{side}", kind, publisher.make(kind, data=count))


def _picture_messages(
    publisher: Publisher,
    robot: SimulatedRobot,
    route: Route,
    scenario: Scenario,
    drawn: Callable[[int, int], None],
) -> Iterator[Published]:
    random = np.random.default_rng([scenario.seed, 4])
    rig = robot.rig_cameras
    renderers = [BoardRenderer(c, route.board, scenario.blur_px, random) for c in (rig.left, rig.right)]
    times = scenario.picture_times_s(route)
    sides: tuple[Side, Side] = ("left", "right")
    topics = robot.topics(compressed=scenario.pictures != "mono8")
    for i, time_s in enumerate(times):
        stamp = int(nanoseconds(np.array([time_s + scenario.camera_late_s]))[0])
        base = base_in_world(route.drive.poses(np.array([time_s])))[0]
        T_w_c = base @ robot.head_pose(route.joints(np.array([time_s]))[0]) @ robot.T_h_c
        for side, info, renderer, T_c_x in zip(
            sides, robot.infos, renderers, (np.eye(4), rig.T_c_r), strict=True
        ):
            grey = renderer.picture(np.linalg.inv(T_w_c @ T_c_x) @ route.T_w_k)
            if not scenario.exact:
                grey = grey + scenario.pixel_noise_grey * random.normal(size=grey.shape)
            kind, message = publisher.picture(grey, info.frame_id, stamp, scenario)
            yield Published(stamp, topics.image[side], kind, message)
            kind = "sensor_msgs/msg/CameraInfo"
            yield Published(stamp, topics.info[side], kind, publisher.camera_info(info, stamp))
        drawn(i + 1, len(times))


def published(
    scenario: Scenario,
    robot: SimulatedRobot,
    route: Route,
    publisher: Publisher,
    drawn: Callable[[int, int], None],
) -> Iterator[Published]:
    """All messages of a recording in order of time, created lazily.

    Args:
        scenario, robot, route: what to record.
        publisher: for ROS 1 or 2.
        drawn: called with the number of rendered stereo pairs and their total.
    """
    description = publisher.make("std_msgs/msg/String", data=urdf_text(robot))
    return heapq.merge(
        [Published(START_NS, "/robot_description", "std_msgs/msg/String", description)],
        _state_messages(publisher, robot, route, scenario),
        _picture_messages(publisher, robot, route, scenario, drawn),
        key=lambda m: m.time_ns,
    )
