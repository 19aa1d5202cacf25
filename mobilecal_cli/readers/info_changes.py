"""Camera calibrations that change in the middle of a recording."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import CAMERA_INFO, CAMERA_INFO_CHANGES, CameraInfo
from mobilecal_cli.readers.camera_info import camera_info
from mobilecal_cli.readers.channels import NOT_ITS_TYPE, Channel, Payload
from mobilecal_cli.readers.recording import Recording
from mobilecal_cli.readers.storage import Extent

#: Bytes of a recording that are read for camera infos alone.
_SAMPLED_BYTES = 2**26
#: In both encodings of ROS, the time stamp and the counter are within the first bytes.
_STAMP_BYTES = 12
_SAME_RELATIVE, _SAME = 1e-6, 1e-9


class InfoChanges:
    """Compares every camera info of some topics with the first one of its topic.

    Args:
        recording: the open recording.
        topics: camera-info topics; those that the recording does not contain are ignored.
    """

    def __init__(self, recording: Recording, topics: Iterable[str]) -> None:
        present = {info.name for info in recording.topics if info.type == CAMERA_INFO}
        self.topics = frozenset(topics) & present
        self._recording = recording
        self._start_ns = recording.start_ns
        self._first: dict[str, CameraInfo] = {}
        self._last: dict[str, bytes] = {}
        self._different: dict[str, bool] = {}
        self._messages = dict.fromkeys(sorted(self.topics), 0)
        self._changed: dict[str, int] = {}
        self._told: dict[str, str] = {}

    def cheap_with(self, topics: Iterable[str]) -> bool:
        """Whether reading them together with other topics reads little more of the file."""
        others = frozenset(topics)
        return (
            self._recording.bytes_of(self.topics | others) - self._recording.bytes_of(others)
            <= _SAMPLED_BYTES
        )

    def sample(self) -> None:
        """Read the topics alone; of a long recording, stretches spread over it."""
        if not self.topics:
            return
        try:
            for channel, log_ns, payload in self._recording.raw(self.topics, Extent(_SAMPLED_BYTES)):
                self.add(channel, log_ns, payload)
        except RecordingError as error:
            self._recording.note(error.message)

    def add(self, channel: Channel, log_ns: int, payload: Payload) -> None:
        """Compare one message. Only one that differs from the one before is decoded."""
        topic, own = channel.topic, bytes(payload[_STAMP_BYTES:])
        self._messages[topic] += 1
        if self._last.get(topic) != own:
            try:
                found = camera_info(channel.decode(payload), topic)
            except (RecordingError, *NOT_ITS_TYPE):
                return
            self._last[topic] = own
            first = self._first.setdefault(topic, found)
            difference = _difference(first, found)
            self._different[topic] = bool(difference)
            if difference and topic not in self._told:
                since_s = (log_ns - (self._start_ns or log_ns)) * 1e-9
                self._told[topic] = f"{since_s:.1f} s after the start: {difference}"
        if self._different.get(topic):
            self._changed[topic] = self._changed.get(topic, 0) + 1

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each topic whose calibration changes."""
        return tuple(
            f"{topic}: {CAMERA_INFO_CHANGES} {told}; {self._changed[topic]} of {self._messages[topic]} messages differ "
            "from the first, which is used for all images"
            for topic, told in sorted(self._told.items())
        )


def _difference(first: CameraInfo, other: CameraInfo) -> str:
    """What differs beyond rounding, with numbers; "" if nothing does."""
    if (first.width, first.height) != (other.width, other.height):
        return f"image size {first.width} x {first.height} to {other.width} x {other.height}"
    if (first.distortion, len(first.D)) != (other.distortion, len(other.D)):
        return f"distortion model {first.distortion} ({len(first.D)}) to {other.distortion} ({len(other.D)})"
    parts = [
        f"{name} by up to {np.abs(after - before).max():.3g}{unit}"
        for name, before, after, unit in (
            ("K", first.K, other.K, " px"),
            ("D", first.D, other.D, ""),
            ("P", first.P, other.P, " px"),
        )
        if not np.allclose(after, before, rtol=_SAME_RELATIVE, atol=_SAME)
    ]
    angle_rad = float(np.linalg.norm(se3.log_so3(first.R.T @ other.R)))
    if angle_rad > _SAME_RELATIVE:
        parts.append(f"R by {np.degrees(angle_rad):.3g} deg")
    return ", ".join(parts)
