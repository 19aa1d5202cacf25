"""Camera calibrations that change in a recording: what most messages say is used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import CAMERA_INFO, CAMERA_INFO_CHANGES, CameraInfo, IntArray
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages.camera_info import camera_info
from mobilecal_cli.readers.messages.channels import NOT_ITS_TYPE, Channel, Payload

#: Bytes of a recording that are read for camera infos alone.
_SAMPLED_BYTES = 2**26
#: In both encodings of ROS, the time stamp and the counter are within the first bytes.
_STAMP_BYTES = 12
_SAME_RELATIVE, _SAME = 1e-6, 1e-9
#: Calibrations kept of one topic; a topic with more is that of several cameras.
_MOST_KEPT = 16


@dataclass(slots=True)
class _Stated:
    """What the camera infos of one topic state.

    Attributes:
        infos: the different calibrations, in order of appearance.
        counts: number of messages with each.
        runs: log time of each change, and the calibration from there on.
        last: bytes of the last message after its stamp.
    """

    infos: list[CameraInfo] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    runs: list[tuple[int, int]] = field(default_factory=list)
    last: bytes = b""

    @property
    def usual(self) -> int:
        """The calibration in most messages."""
        return int(np.argmax(self.counts))


class InfoChanges:
    """Compares the camera infos of some topics with one another.

    Args:
        recording: the open recording.
        topics: camera-info topics; those that the recording does not contain are ignored.
    """

    def __init__(self, recording: Recording, topics: Iterable[str]) -> None:
        present = {info.name for info in recording.topics if info.type == CAMERA_INFO}
        self.topics = frozenset(topics) & present
        self._recording = recording
        self._stated = {topic: _Stated() for topic in sorted(self.topics)}

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
        """Take one message. Only one that differs from the one before is decoded."""
        stated, own = self._stated[channel.topic], bytes(payload[_STAMP_BYTES:])
        if stated.last == own and stated.runs:
            stated.counts[stated.runs[-1][1]] += 1
            return
        try:
            found = camera_info(channel.decode(payload), channel.topic)
        except (RecordingError, *NOT_ITS_TYPE):
            return
        known = (k for k, info in enumerate(stated.infos) if not _difference(info, found))
        which = next(known, len(stated.infos))
        if which == len(stated.infos):
            if which == _MOST_KEPT:
                return
            stated.infos.append(found)
            stated.counts.append(0)
        stated.last = own
        stated.counts[which] += 1
        if not stated.runs or stated.runs[-1][1] != which:
            stated.runs.append((log_ns, which))

    @property
    def corrected(self) -> dict[str, CameraInfo]:
        """Topic → the calibration in most messages, where it is not that of the first."""
        return {
            topic: stated.infos[stated.usual]
            for topic, stated in self._stated.items()
            if stated.infos and stated.usual
        }

    def usual_at(self, topic: str, log_ns: IntArray) -> IntArray:
        """(n,) indices of those of some log times at which the topic states its usual calibration."""
        stated = self._stated.get(topic)
        if stated is None or len(stated.runs) < 2:
            return np.arange(len(log_ns))
        starts, which = np.array(stated.runs, dtype=np.int64).T
        run = np.maximum(np.searchsorted(starts, log_ns, side="right") - 1, 0)
        return np.flatnonzero(which[run] == stated.usual)

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each topic whose calibration changes."""
        notes = []
        for topic, stated in self._stated.items():
            if len(stated.runs) < 2:
                continue
            at_ns = stated.runs[1][0]
            since_s = (at_ns - (self._recording.start_ns or at_ns)) * 1e-9
            others = sum(stated.counts) - stated.counts[stated.usual]
            notes.append(
                f"{topic}: {CAMERA_INFO_CHANGES} {since_s:.1f} s after the start: "
                f"{_difference(stated.infos[0], stated.infos[1])}; {others} of {sum(stated.counts)} messages differ "
                "from the others, which are used; images recorded while it differs are left out"
            )
        return tuple(notes)


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
