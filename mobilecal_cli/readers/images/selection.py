"""Images of a recording: a selection of them, or a few near some times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import GrayImage, PictureIndex, Rejection, Side, Sources, StereoLayout
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.images.pixels import LARGEST_PIXELS, decode_image
from mobilecal_cli.readers.images.video import Video, codec_of
from mobilecal_cli.readers.messages.stamps import stamp_of

#: Bytes of a video that are read to find a few key frames.
_GLANCE_BYTES = 2**25


def read_images(
    recording: Recording,
    image_topics: Mapping[Side, str],
    wanted: Mapping[Side, PictureIndex],
    layout: StereoLayout = "separate",
) -> Iterator[tuple[Side, int, GrayImage | Rejection]]:
    """Selected images, one at a time, in the order of the recording.

    Args:
        recording: the open recording.
        image_topics: image topic of each side.
        `wanted`: rows of the index of each side's images.
        layout: arrangement of the two images of a pair.

    Yields:
        Side, time, and the image as (height, width) uint8; or the reason why it cannot be decoded.

    Raises:
        RecordingError: see `Recording.messages`.
    """
    missing: dict[str, dict[tuple[int, int], list[tuple[Side, int]]]] = {}
    for side, index in wanted.items():
        places = missing.setdefault(image_topics[side], {})
        for time_ns, *place in zip(
            *(a.tolist() for a in (index.time_ns, index.log_ns, index.stamp_ns)), strict=True
        ):
            places.setdefault(tuple(place), []).append((side, time_ns))
    if not any(index.sequential for index in wanted.values()):
        logged = np.unique(np.concatenate([index.log_ns for index in wanted.values()]))
        yield from _read(recording, missing, layout, Extent(at_ns=logged))
    if any(missing.values()):  # video, or a wrong index
        yield from _read(recording, missing, layout, EVERYTHING)


def _read(
    recording: Recording,
    missing: dict[str, dict[tuple[int, int], list[tuple[Side, int]]]],
    layout: StereoLayout,
    extent: Extent,
) -> Iterator[tuple[Side, int, GrayImage | Rejection]]:
    """One pass for the missing images; removes those that are found.

    Args:
        recording: the open recording.
        missing: topic → log time and stamp of an image → its sides, and the times to return.
        layout: see `read_images`.
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
        for side, time_ns in wanted:
            yield side, time_ns, picture if isinstance(picture, Rejection) else _part(picture, side, layout)
        if not any(missing.values()):
            return


def pictures_near(
    recording: Recording, sources: Sources, times_ns: Sequence[int]
) -> Iterator[GrayImage | Rejection]:
    """First images of both cameras after given times, without reading the whole recording.

    Args:
        recording: the open recording.
        sources: its image topics.
        times_ns: log times.

    Yields:
        (height, width) uint8, or the reason why an image cannot be decoded.
    """
    sides: dict[str, list[Side]] = {}
    for side, topic in sources.image.items():
        sides.setdefault(topic, []).append(side)
    videos = []
    for message in recording.near(sides, times_ns):
        try:
            decoded = message.decode()
            if codec_of(decoded) is not None:
                videos.append(message.topic)
                continue
            picture = decode_image(decoded)
        except RecordingError as error:
            yield Rejection("readers", "image cannot be decoded", error.message, message.log_time_ns)
            continue
        for side in sides[message.topic]:
            yield _part(picture, side, sources.layout)
    for topic in dict.fromkeys(videos):
        for frame in _key_frames(recording, topic, times_ns):
            for side in sides[topic]:
                yield _part(frame, side, sources.layout)


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
        videos[topic] = Video(codec, LARGEST_PIXELS)
    return videos[topic]


def _part(picture: GrayImage, side: Side, layout: StereoLayout) -> GrayImage:
    """One camera's part of an image."""
    if layout == "separate":
        return picture
    first, second = np.array_split(picture, 2, axis=1 if layout == "side_by_side" else 0)
    return np.ascontiguousarray(first if side == "left" else second)
