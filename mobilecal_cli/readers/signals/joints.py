"""Joints: read from joint states, or from transforms; `FieldSource` reads them from a field of any message."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import JointTransform
from mobilecal_cli.model.signals import JOINT_STATE, Track
from mobilecal_cli.model.text import listed
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, frame_of, stamp_of
from mobilecal_cli.readers.messages.types import Decoded
from mobilecal_cli.readers.signals.series import Samples
from mobilecal_cli.readers.signals.sources import Source, Subscriptions

#: Names that are kept for messages; where each message has others, all of them would fill the memory.
_MOST_PRESENT = 1000


class StatedJoint(Source):
    """A joint in the joint states of one topic.

    Args:
        field: "position" or "velocity".

    Attributes:
        name: of the joint.
        present: names of the joints in the messages, in order: its own if it is there, and a thousand others.
    """

    types = (JOINT_STATE,)

    def __init__(self, topic: str, name: str, field: str = "position") -> None:
        positions = field == "position"
        of_field = "" if positions else f"{field} of "
        super().__init__(topic, f"{of_field}joint {name} on {topic}", positions=positions)
        self.present: dict[str, None] = {}
        self.name, self._field = name, field
        self._names: list[str] = []
        self._place: int | None = None

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        """Read one message; the order of names may change from message to message."""
        if message.name != self._names:
            names = self._names = list(message.name)
            self._place = names.index(self.name) if self.name in names else None
            self.present.update(dict.fromkeys(names[: max(_MOST_PRESENT - len(self.present), 0)]))
            if self._place is not None:
                self.present[self.name] = None
        values = getattr(message, self._field, ())
        if self._place is None:
            return
        if self._place < len(values):
            self.add(time_ns, log_ns, float(values[self._place]))
        else:
            self.missing += 1

    def checked(self, notes: list[str]) -> Source:
        if not (len(self) or self.impossible):
            raise RecordingError(
                f"no position of joint {self.name} on {self.topic}; joints present: {listed(self.present)}",
                "correct joints in rig.yaml, or the URDF's joint names",
            )
        return self


#: Bytes of a recording that are read to compare topics, or for its transforms.
SAMPLED_BYTES = 2**28
#: A joint whose range is this share of that on another topic stands still.
_STILL_SHARE = 0.01


def most_stated(topics: Sequence[StatedJoint], wheel: bool) -> StatedJoint:
    """A joint on the topic that says most of it: where it moves, else where it is not zero; with most readings.

    Args:
        topics: the joint on each topic.
        wheel: whether it is one, which may count from any zero.

    Raises:
        RecordingError: two topics say as much, and their readings differ.
    """
    largest = max(joint.range for joint in topics)
    moving = [joint for joint in topics if joint.range > _STILL_SHARE * largest]
    best = max(moving or topics, key=lambda joint: joint.says)
    like = moving or [joint for joint in topics if joint.says[1]]
    others = (joint for joint in like if joint is not best)
    other = next((joint for joint in others if joint.differs(best, wheel)), None)
    if other is not None:
        setting = "wheels.left.topic and wheels.right.topic" if wheel else "joints.topic"
        raise RecordingError(
            f"joint {best.name} has different readings on {best.topic} and on {other.topic}",
            f"set {setting} in rig.yaml to the topic of this robot's driver",
        )
    return best


def choose_topics(
    recording: Recording, shared: Mapping[str, Sequence[str]], wheels: Collection[str]
) -> tuple[dict[str, str], dict[str, RecordingError]]:
    """The topic that says most of each joint (see `most_stated`), and why others lack one; notes name what is not read.

    Args:
        recording: in which joints are on several topics.
        shared: joint → these topics.
        wheels: those that are wheels, which may have velocities alone.
    """
    read = Subscriptions(recording)
    positions = {name: [read.add(StatedJoint(topic, name)) for topic in on] for name, on in shared.items()}
    velocities = {
        name: [read.add(StatedJoint(topic, name, "velocity")) for topic in shared[name]] for name in wheels
    }
    read.run(Extent(SAMPLED_BYTES), {})
    chosen: dict[str, str] = {}
    problems: dict[str, RecordingError] = {}
    silent: dict[tuple[str, str, str], list[str]] = {}
    for name, joints in positions.items():
        kinds = (joints, velocities.get(name, []))
        moving = next((each for each in kinds if any(joint.range for joint in each)), joints)
        try:
            best = most_stated(moving, name in wheels)
        except RecordingError as error:
            problems[name] = error
            continue
        chosen[name] = best.topic
        for joint in (joint for joint in moving if joint is not best):
            if joint.impossible and not len(joint):
                why = joint.impossible_words
            elif joint.range <= _STILL_SHARE * best.range and (best.range or joint.says[1] < best.says[1]):
                why = "they stand still"
            else:
                continue
            silent.setdefault((best.topic, joint.topic, why), []).append(name)
    for (topic, other, why), names in silent.items():
        recording.note(f"Joints {listed(names)}: read on {topic}, not on {other}, where {why}.")
    return chosen, problems


def never_changing(
    recording: Recording,
    topics: Collection[str],
    names: Collection[str],
    states: Callable[[str, Decoded], Iterable[tuple[str, list[float]]]],
) -> set[str]:
    """Those of some names whose numbers never change on any of the topics; read until all have changed.

    Args:
        states: (name, numbers) in a message of a topic.
    """
    first: dict[tuple[str, str], list[float]] = {}
    left = {*names}
    for message in recording.messages(topics, Extent(SAMPLED_BYTES)) if left else ():
        with suppress(RecordingError, *NOT_ITS_TYPE):
            for name, values in states(message.topic, message.decode()):
                if name in left and first.setdefault((message.topic, name), values) != values:
                    left.remove(name)
        if not left:
            break
    return left & {name for _, name in first}


def joint_numbers(topic: str, state: Decoded) -> Iterator[tuple[str, list[float]]]:
    """Position and velocity of each joint of a joint state."""
    fields = [getattr(state, kind, ()) for kind in ("position", "velocity")]
    for place, name in enumerate(state.name):
        yield name, [float(values[place]) for values in fields if place < len(values)]


def pose_numbers(topic: str, state: Decoded) -> Iterator[tuple[str, list[float]]]:
    """Place and heading of an odometry message, by its topic."""
    place, turn = state.pose.pose.position, state.pose.pose.orientation
    yield topic, [float(value) for value in (place.x, place.y, turn.z, turn.w)]


#: A transform that deviates by more from the motion of its joint belongs to another robot or URDF.
_OFF_RAD, _OFF_M = 0.02, 0.005
#: Samples stored of each transform.
_MOST_SAMPLES = 400
#: Other transforms that are kept for messages.
_MOST_OTHERS = 40


class TransformJoint(Source):
    """A joint in the transforms of one topic."""

    def __init__(self, name: str, source: JointTransform) -> None:
        super().__init__(source.topic, f"joint {name} on {source.topic}", positions=True)
        self._name, self._source = name, source
        self._worst = (0.0, 0.0)
        self._present: dict[str, None] = {}

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        for item in message.transforms:
            ends = (frame_of(item.header), item.child_frame_id.lstrip("/"))
            if ends != (self._source.parent, self._source.child):
                if len(self._present) < _MOST_OTHERS:
                    self._present[" to ".join(ends)] = None
                continue
            value, *off = reading(self._source, item.transform)
            self.add(stamp_of(item, time_ns), log_ns, value)
            self._worst = (max(self._worst[0], off[0]), max(self._worst[1], off[1]))

    def checked(self, notes: list[str]) -> Source:
        """Note where the readings come from.

        Raises:
            RecordingError: the transform is missing, or does not move as the URDF states.
        """
        source = self._source
        if not len(self) and not self.impossible:
            raise RecordingError(
                f"{self.topic}: no transform from {source.parent} to {source.child}, needed for joint {self._name}; "
                f"present: {listed(self._present)}",
                "record /joint_states, or use the URDF that the transforms were computed with",
            )
        off_rad, off_m = self._worst
        if off_rad > _OFF_RAD or off_m > _OFF_M:
            raise RecordingError(
                f"{self.topic}: the transform from {source.parent} to {source.child} deviates from joint "
                f"{self._name} by up to {math.degrees(off_rad):.1f} degrees and {off_m * 1e3:.0f} mm "
                f"(limit {math.degrees(_OFF_RAD):.1f} degrees, {_OFF_M * 1e3:.0f} mm)",
                "use the URDF that the transforms were computed with",
            )
        notes.append(f"{self.label}: read from the transform from {source.parent} to {source.child}")
        return self

    def track(self, samples: Samples, notes: list[str]) -> Track:
        track = super().track(samples, notes)
        return track if self._source.kind == "prismatic" else Track(track.time_ns, np.unwrap(track.value))


def transforms_of(messages: Iterable[Decoded]) -> dict[tuple[str, str], FloatArray]:
    """Samples of all transforms in TF messages, (parent, child) → (n, 4, 4), m."""
    samples_of: dict[tuple[str, str], list[FloatArray]] = {}
    for message in messages:
        try:
            items = list(message.transforms)
        except NOT_ITS_TYPE:
            continue
        for item in items:
            try:
                ends = (frame_of(item.header), str(item.child_frame_id).lstrip("/"))
                T = _matrix(item.transform)
            except NOT_ITS_TYPE:
                continue
            if T is not None:
                samples = samples_of.setdefault(ends, [])
                samples.append(T)
                if len(samples) > _MOST_SAMPLES:  # keep the first and every second of the others
                    del samples[1::2]
    return {ends: np.stack(samples) for ends, samples in samples_of.items()}


def _matrix(transform: Decoded) -> FloatArray | None:
    """(4, 4) of a geometry_msgs/Transform, None if it is not finite."""
    q, t = transform.rotation, transform.translation
    quaternion, place = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
    if not (np.isfinite(quaternion).all() and np.isfinite(place).all() and np.linalg.norm(quaternion) > 0.5):
        return None
    return se3.transform(se3.from_quaternion_xyzw(quaternion / np.linalg.norm(quaternion)), place)


def reading(source: JointTransform, transform: Decoded) -> tuple[float, float, float]:
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
