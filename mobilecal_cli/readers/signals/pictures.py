"""Images by the container's index: log times of all of them, and stamps of a selection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import IMAGES, IntArray, PictureIndex, Side
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.images.video import codec_of
from mobilecal_cli.readers.messages.channels import NOT_ITS_TYPE
from mobilecal_cli.readers.messages.stamps import content_of, header_stamp_ns, stamp_of
from mobilecal_cli.readers.signals.clocks import Clock

#: Places of a topic, spread over it, where two images are read to measure the lag between stamp and log time.
_LOOKS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Log times of all images, and the lag of a few of them.

    Attributes:
        logged_ns: topic → (n,) increasing log times.
        lag_ns: topic → median of log time minus stamp.
        spread_ns: largest range of the lags of one topic.
        clocks: statistics of the stamps of those few images.
    """

    logged_ns: Mapping[str, IntArray]
    lag_ns: Mapping[str, int]
    spread_ns: int
    clocks: tuple[Clock, ...]

    def index(self, topic: str) -> PictureIndex:
        """A topic's images, with approximate stamps: log times minus the lag."""
        logged_ns = self.logged_ns[topic]
        stamp_ns = logged_ns - self.lag_ns[topic]
        return PictureIndex(stamp_ns, stamp_ns, logged_ns)


def find_pictures(recording: Recording, image_topics: Mapping[Side, str]) -> Pictures | None:
    """Log times and approximate stamps of the images, without reading them all.

    Args:
        recording: the open recording.
        image_topics: image topic of each side.

    Returns:
        None if they cannot be determined: no index, no such topic, missing stamps, undecodable images, identical
        consecutive images, or video, which needs every frame.
    """
    types = {info.name: info.type for info in recording.topics}
    topics = sorted(set(image_topics.values()))
    if any(types.get(topic) not in IMAGES for topic in topics):
        return None
    times = recording.log_times()
    if any(topic not in times for topic in topics):
        return None
    logged = {topic: np.unique(times[topic]) for topic in topics}
    lags: dict[str, list[int]] = {}
    clocks = []
    for topic, logged_ns in logged.items():
        clock = Clock(topic)
        some = np.linspace(0, len(logged_ns) - 1, _LOOKS).astype(int)
        moments = logged_ns[np.union1d(some, np.minimum(some + 1, len(logged_ns) - 1))]
        before, content = 0, b""
        try:
            for message in recording.near([topic], moments.tolist()):
                decoded = message.decode()
                if codec_of(decoded) is not None:
                    return None
                last, content = content, content_of(decoded)
                if message.log_time_ns > before and content == last != b"":
                    return None
                before = message.log_time_ns
                stamp_ns = clock.count(header_stamp_ns(decoded), message.log_time_ns)
                lags.setdefault(topic, []).append(message.log_time_ns - stamp_ns)
        except (RecordingError, *NOT_ITS_TYPE):
            return None
        if not clock.messages or clock.unstamped:
            return None
        clocks.append(clock)
    middle = {topic: sorted(found)[len(found) // 2] for topic, found in lags.items()}
    spread = max(max(found) - min(found) for found in lags.values())
    return Pictures(logged, middle, spread, tuple(clocks))


def read_stamps(
    recording: Recording, logged_ns: Mapping[str, IntArray]
) -> tuple[dict[str, dict[int, int]], tuple[str, ...]] | None:
    """Stamps of selected images; only the blocks that contain them are read.

    Args:
        recording: the open recording.
        logged_ns: topic → (n,) log times of the selected images. Of several with one log time, the first is used.

    Returns:
        Topic → log time → stamp, ns, and notes on undecodable images, which have no stamp. None if the index is wrong,
        and images are not where it says, or if a selected image is identical to the one selected before it.
    """
    wanted = {topic: set(times.tolist()) for topic, times in logged_ns.items()}
    found: dict[str, dict[int, int]] = {topic: {} for topic in logged_ns}
    broken = dict.fromkeys(logged_ns, 0)
    before = dict.fromkeys(logged_ns, b"")
    extent = Extent(at_ns=np.unique(np.concatenate(list(logged_ns.values()))))
    for message in recording.messages(wanted, extent):
        topic, log_ns = message.topic, message.log_time_ns
        if log_ns not in wanted[topic]:
            continue
        wanted[topic].remove(log_ns)
        try:
            decoded = message.decode()
            stamp_ns = stamp_of(decoded, log_ns)
            last, before[topic] = before[topic], content_of(decoded)
        except (RecordingError, *NOT_ITS_TYPE):
            broken[topic] += 1
            continue
        if before[topic] == last != b"":
            return None
        found[topic][log_ns] = stamp_ns
        if not any(wanted.values()):
            break
    if any(wanted.values()):
        return None
    notes = tuple(
        f"{topic}: {count} of the {len(logged_ns[topic])} selected images do not match their type; ignored"
        for topic, count in broken.items()
        if count
    )
    return found, notes
