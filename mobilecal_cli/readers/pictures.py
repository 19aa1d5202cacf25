"""Images of a recording: a selection of them, or a few near some times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    GrayImage,
    PictureIndex,
    Rejection,
    Sources,
    StereoLayout,
)
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.messages import stamp_of
from mobilecal_cli.readers.pixels import Video, codec_of, decode_image

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
