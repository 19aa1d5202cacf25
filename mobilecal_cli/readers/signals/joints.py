"""Joints: read from joint states, from transforms, or from a field of any message."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import FloatArray, JointTransform, Track, listed
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import FieldPath, stamp_of
from mobilecal_cli.readers.signals.series import Samples, Series

#: Names that are kept for messages; where each message has others, all of them would fill the memory.
_MOST_PRESENT = 1000


class JointStates:
    """Positions and velocities of named joints on one topic.

    Attributes:
        position: name → readings, of the subscribed joints.
        velocity: the same, of joints whose velocities are used.
        present: names found, in order: those of the subscribed joints, and a thousand others.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.position: dict[str, Series] = {}
        self.velocity: dict[str, Series] = {}
        self.present: dict[str, None] = {}
        self._names: list[str] = []
        self._places: list[tuple[int, Series, str]] = []

    def want(self, name: str, *, velocity: bool = False) -> None:
        """Subscribe to a joint."""
        self.position.setdefault(name, Series(self.topic, f"joint {name} on {self.topic}"))
        if velocity:
            self.velocity.setdefault(name, Series(self.topic, f"velocity of joint {name} on {self.topic}"))

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message; the order of names may change from message to message."""
        if message.name != self._names:
            names = self._names = list(message.name)
            self.present.update(dict.fromkeys(names[: max(_MOST_PRESENT - len(self.present), 0)]))
            self.present.update(dict.fromkeys(name for name in self.position if name in names))
            self._places = [
                (names.index(name), series, field)
                for field in ("position", "velocity")
                for name, series in getattr(self, field).items()
                if name in names
            ]
        for place, series, field in self._places:
            values = getattr(message, field, ())
            if place < len(values):
                series.add(time_ns, log_ns, float(values[place]))


#: A transform that deviates by more from the motion of its joint belongs to another robot or URDF.
_OFF_RAD, _OFF_M = 0.02, 0.005
#: Bytes of a recording that are read for its transforms, and samples stored of each.
_SAMPLED_BYTES, _MOST_SAMPLES = 2**28, 400


class Transforms:
    """Joints in the transforms of one topic.

    Args:
        joints: name → its transform.

    Attributes:
        series: name → readings.
    """

    def __init__(self, topic: str, joints: Mapping[str, JointTransform]) -> None:
        self._topic = topic
        self._joints = dict(joints)
        self._wanted = {(source.parent, source.child): name for name, source in joints.items()}
        self.series = {name: Series(topic, f"joint {name} on {topic}") for name in joints}
        self._worst = dict.fromkeys(joints, (0.0, 0.0))
        self._present: dict[str, None] = {}

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one TFMessage."""
        for item in message.transforms:
            ends = (item.header.frame_id.lstrip("/"), item.child_frame_id.lstrip("/"))
            name = self._wanted.get(ends)
            if name is None:
                if len(self._present) < 40:
                    self._present[" to ".join(ends)] = None
                continue
            value, off_rad, off_m = reading(self._joints[name], item.transform)
            self.series[name].add(stamp_of(item, time_ns), log_ns, value)
            worst = self._worst[name]
            self._worst[name] = (max(worst[0], off_rad), max(worst[1], off_m))

    def check(self, name: str, notes: list[str]) -> None:
        """Check the readings of a joint, and note where they come from.

        Raises:
            RecordingError: its transform is missing, or does not move as the URDF states.
        """
        source, series = self._joints[name], self.series[name]
        if not len(series) and not series.not_finite:
            raise RecordingError(
                f"{self._topic}: no transform from {source.parent} to {source.child}, needed for joint {name}; "
                f"present: {listed(self._present)}",
                "record /joint_states, or use the URDF that the transforms were computed with",
            )
        off_rad, off_m = self._worst[name]
        if off_rad > _OFF_RAD or off_m > _OFF_M:
            raise RecordingError(
                f"{self._topic}: the transform from {source.parent} to {source.child} deviates from joint {name} "
                f"by up to {math.degrees(off_rad):.1f} degrees and {off_m * 1e3:.0f} mm "
                f"(limit {math.degrees(_OFF_RAD):.1f} degrees, {_OFF_M * 1e3:.0f} mm)",
                "use the URDF that the transforms were computed with",
            )
        notes.append(f"{series.label}: read from the transform from {source.parent} to {source.child}")

    def track(self, name: str, samples: Samples, notes: list[str]) -> Track:
        """Track of a joint."""
        time_ns, value = samples.ordered(notes)
        return Track(
            time_ns, value[:, 0] if self._joints[name].kind == "prismatic" else np.unwrap(value[:, 0])
        )


def transforms_of(recording: Recording, topics: Sequence[str]) -> dict[tuple[str, str], FloatArray]:
    """Samples of all transforms of a recording, (parent, child) → (n, 4, 4), m; a long recording is read in parts."""
    samples_of: dict[tuple[str, str], list[FloatArray]] = {}
    for message in recording.messages(topics, Extent(_SAMPLED_BYTES)) if topics else ():
        try:
            items = message.decode().transforms
        except (RecordingError, AttributeError):
            continue
        for item in items:
            try:
                ends = (str(item.header.frame_id).lstrip("/"), str(item.child_frame_id).lstrip("/"))
                T = _matrix(item.transform)
            except (AttributeError, TypeError, ValueError):  # JSON may contain anything
                continue
            if T is not None:
                samples = samples_of.setdefault(ends, [])
                samples.append(T)
                if len(samples) > _MOST_SAMPLES:  # keep the first and every second of the others
                    del samples[1::2]
    return {ends: np.stack(samples) for ends, samples in samples_of.items()}


def _matrix(transform: Any) -> FloatArray | None:  # noqa: ANN401
    """(4, 4) of a geometry_msgs/Transform, None if it is not finite."""
    q, t = transform.rotation, transform.translation
    quaternion, place = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
    if not (np.isfinite(quaternion).all() and np.isfinite(place).all() and np.linalg.norm(quaternion) > 0.5):
        return None
    return se3.transform(se3.from_quaternion_xyzw(quaternion / np.linalg.norm(quaternion)), place)


def reading(source: JointTransform, transform: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Position of a joint from the transform of its link.

    Returns:
        rad (or m), and deviation of the transform from the joint's motion: rad, m. NaN if the transform is not finite.
    """
    T = _matrix(transform)
    if T is None:
        return math.nan, 0.0, 0.0
    moved: FloatArray = se3.inverse(source.T_parent_child) @ T
    turn = se3.log_so3(moved[:3, :3])
    if source.kind == "prismatic":
        way = float(source.axis @ moved[:3, 3])
        return way, float(np.linalg.norm(turn)), float(np.linalg.norm(moved[:3, 3] - way * source.axis))
    # The axis is known, so this also works near half a turn, where the logarithm may choose the other sign.
    R, a = moved[:3, :3], source.axis
    angle = math.atan2(
        float(a @ np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])), float(np.trace(R) - 1)
    )
    rest = se3.log_so3(se3.rotation_about(a, np.array(-angle)) @ R)
    return angle, float(np.linalg.norm(rest)), float(np.linalg.norm(moved[:3, 3]))


class FieldSeries:
    """The number at a field path of each message on a topic.

    Args:
        setting: key of the path in rig.yaml, for error messages.
        series: receives the readings.
        scaled: value that is added to the series for a number.

    Raises:
        RecordingError: not a valid path.
    """

    def __init__(self, path: str, setting: str, series: Series, scaled: Callable[[float], float]) -> None:
        self._path, self._setting = FieldPath.parse(path), setting
        self._series, self._scaled = series, scaled
        self._missing = 0
        self._error: RecordingError | None = None

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        try:
            value = self._path.number(message, self._series.topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self._missing += 1
            self._error = self._error or error
            return
        self._series.add(time_ns, log_ns, self._scaled(value))

    def check(self, notes: list[str]) -> None:
        """Note missing readings; raise the first error if nothing was read."""
        if self._error is not None:
            if not len(self._series):
                raise self._error
            notes.append(f"{self._series.label}: the field is missing in {self._missing} messages; ignored")
