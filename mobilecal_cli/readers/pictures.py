"""Images of a recording: their times by the container's index, a selection of them, or a few near some times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    IMAGES,
    GrayImage,
    IntArray,
    PictureIndex,
    Rejection,
    Sources,
    StereoLayout,
)
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, content_of, header_stamp_ns, stamp_of
from mobilecal_cli.readers.pixels import Video, codec_of, decode_image
from mobilecal_cli.readers.signals.series import Clock

#: Places of a topic, spread over it, where two images are read to measure the lag between stamp and log time.
_LOOKS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """All images by their log times, and how far these are from the stamps.

    Attributes:
        index: topic → its images, with approximate stamps: log times minus the median lag of a few images.
        spread_ns: largest range of the lags of one topic.
        clocks: statistics of the stamps of those few images.
    """

    index: Mapping[str, PictureIndex]
    spread_ns: int
    clocks: tuple[Clock, ...]


def find_pictures(recording: Recording, image_topics: Mapping[str, str]) -> Pictures | None:
    """Log times and approximate stamps of the images, without reading them all.

    Args:
        image_topics: image topic of each camera.

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
    index, clocks, spread_ns = {}, [], 0
    for topic in topics:
        clock, logged_ns, lags_ns = Clock(topic), np.unique(times[topic]), []
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
                log_ns = message.log_time_ns
                lags_ns.append(log_ns - clock.count(header_stamp_ns(decoded), log_ns))
        except (RecordingError, *NOT_ITS_TYPE):
            return None
        if not clock.messages or clock.unstamped:
            return None
        clocks.append(clock)
        spread_ns = max(spread_ns, max(lags_ns) - min(lags_ns))
        stamp_ns = logged_ns - sorted(lags_ns)[len(lags_ns) // 2]
        index[topic] = PictureIndex(stamp_ns, stamp_ns, logged_ns)
    return Pictures(index, spread_ns, tuple(clocks))


def read_stamps(
    recording: Recording, logged_ns: Mapping[str, IntArray]
) -> tuple[dict[str, dict[int, int]], tuple[str, ...]] | None:
    """Stamps of selected images; only the blocks that contain them are read.

    Args:
        logged_ns: topic → (n,) log times of the selected images. Of several with one log time, the first is used.

    Returns:
        Topic → log time → stamp, ns, and notes on undecodable images, which have no stamp. None if the index is wrong,
        and images are not where it says, or if a selected image is identical to the one selected before it.
    """
    wanted = {topic: set(times.tolist()) for topic, times in logged_ns.items()}
    stamps_ns: dict[str, dict[int, int]] = {topic: {} for topic in logged_ns}
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
        stamps_ns[topic][log_ns] = stamp_ns
        if not any(wanted.values()):
            break
    if any(wanted.values()):
        return None
    notes = tuple(
        f"{topic}: {count} of the {len(logged_ns[topic])} selected images do not match their type; ignored"
        for topic, count in broken.items()
        if count
    )
    return stamps_ns, notes


#: Bytes of a video that are read to find a few key frames.
_GLANCE_BYTES = 2**25


def read_images(
    recording: Recording,
    image_topics: Mapping[str, str],
    wanted: Mapping[str, PictureIndex],
    layout: StereoLayout = "separate",
) -> Iterator[tuple[str, int, GrayImage | Rejection]]:
    """Selected images, one at a time, in the order of the recording.

    Args:
        image_topics: image topic of each camera.
        `wanted`: rows of the index of each camera's images.

    Yields:
        Camera, time, and the image as (height, width) uint8; or the reason why it cannot be decoded.

    Raises:
        RecordingError: see `Recording.messages`.
    """
    missing: dict[str, dict[tuple[int, int], list[tuple[str, int]]]] = {}
    for name, index in wanted.items():
        places = missing.setdefault(image_topics[name], {})
        for time_ns, *place in zip(
            *(a.tolist() for a in (index.time_ns, index.log_ns, index.stamp_ns)), strict=True
        ):
            places.setdefault(tuple(place), []).append((name, time_ns))
    if not any(index.sequential for index in wanted.values()):
        logged = np.unique(np.concatenate([index.log_ns for index in wanted.values()]))
        yield from _read(recording, missing, layout, Extent(at_ns=logged))
    if any(missing.values()):  # video, or a wrong index
        yield from _read(recording, missing, layout, EVERYTHING)


def _read(
    recording: Recording,
    missing: dict[str, dict[tuple[int, int], list[tuple[str, int]]]],
    layout: StereoLayout,
    extent: Extent,
) -> Iterator[tuple[str, int, GrayImage | Rejection]]:
    """One pass for the missing images; removes those that are found.

    Args:
        missing: topic → log time and stamp of an image → its cameras, and the times to return.
        extent: how much of the recording is read.
    """
    videos: dict[str, Video] = {}
    for message in recording.messages([topic for topic, places in missing.items() if places], extent):
        try:
            decoded = message.decode()
        except RecordingError:
            continue  # without a stamp, it cannot have been selected
        stamp_ns = stamp_of(decoded, message.log_time_ns)
        wanted = missing[message.topic].pop((message.log_time_ns, stamp_ns), [])
        video = _video(videos, message.topic, decoded)
        if not wanted and video is None:
            continue
        picture: GrayImage | Rejection
        try:
            picture = decode_image(decoded) if video is None else video.picture(decoded.data)
        except RecordingError as error:
            detail = f"{message.topic}: {error.message}"
            picture = Rejection("readers", "image cannot be decoded", detail, stamp_ns)
        for name, time_ns in wanted:
            yield name, time_ns, picture if isinstance(picture, Rejection) else _part(picture, name, layout)
        if not any(missing.values()):
            return


def pictures_near(
    recording: Recording, sources: Sources, times_ns: Sequence[int]
) -> Iterator[GrayImage | Rejection]:
    """First images of all cameras after given times, without reading the whole recording.

    Args:
        times_ns: log times.

    Yields:
        (height, width) uint8, or the reason why an image cannot be decoded.
    """
    names: dict[str, list[str]] = {}
    for name, topic in sources.image.items():
        names.setdefault(topic, []).append(name)
    videos = []
    for message in recording.near(names, times_ns):
        try:
            decoded = message.decode()
            if codec_of(decoded) is not None:
                videos.append(message.topic)
                continue
            picture = decode_image(decoded)
        except RecordingError as error:
            yield Rejection("readers", "image cannot be decoded", error.message, message.log_time_ns)
            continue
        for name in names[message.topic]:
            yield _part(picture, name, sources.layout)
    for topic in dict.fromkeys(videos):
        for frame in _key_frames(recording, topic, times_ns):
            for name in names[topic]:
                yield _part(frame, name, sources.layout)


def _key_frames(recording: Recording, topic: str, times_ns: Sequence[int]) -> Iterator[GrayImage]:
    """First key frame of a video after each time, if it is within the stretches that are read."""
    waiting = sorted(times_ns)
    for message in recording.messages([topic], Extent(_GLANCE_BYTES)):
        if not waiting:
            return
        if message.log_time_ns < waiting[0]:
            continue
        with suppress(RecordingError):
            decoded = message.decode()
            video = _video({}, topic, decoded)
            if video is None:
                continue
            frame = video.picture(decoded.data)
            while waiting and waiting[0] <= message.log_time_ns:
                waiting.pop(0)
            yield frame


def _video(videos: dict[str, Video], topic: str, message: Any) -> Video | None:  # noqa: ANN401
    """Decoder of a topic's video, created with its first frame; None for single images."""
    codec = codec_of(message)
    if codec is None:
        return None
    if topic not in videos:
        videos[topic] = Video(codec)
    return videos[topic]


def _part(picture: GrayImage, name: str, layout: StereoLayout) -> GrayImage:
    """One camera's part of an image."""
    if layout == "separate":
        return picture
    first, second = np.array_split(picture, 2, axis=1 if layout == "side_by_side" else 0)
    return np.ascontiguousarray(first if name == "left" else second)
