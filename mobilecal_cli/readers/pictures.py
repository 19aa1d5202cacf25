"""Images of a recording: a selection of them, or a few near some times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import GrayImage, PictureIndex, Rejection, Sources, StereoLayout
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent, Message
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, stamp_of
from mobilecal_cli.readers.pixels import Video, codec_of, decode_image

#: Bytes of a topic that are read to find a few images by their order alone.
_GLANCE_BYTES = 2**25


def read_images(
    recording: Recording, sources: Sources, wanted: Mapping[str, PictureIndex]
) -> Iterator[tuple[str, int, GrayImage | Rejection]]:
    """Selected images, one at a time, in the order of the recording.

    Args:
        sources: topics of the images, and their layout.
        `wanted`: rows of the index of each camera's images.

    Yields:
        Camera, time, and the image as (height, width) uint8; or the reason why it cannot be decoded.

    Raises:
        RecordingError: see `Recording.messages`.
    """
    missing: dict[str, dict[tuple[int, int], list[tuple[str, int]]]] = {}
    for name, index in wanted.items():
        places = missing.setdefault(sources.image[name], {})
        for time_ns, *place in zip(
            *(a.tolist() for a in (index.time_ns, index.log_ns, index.stamp_ns)), strict=True
        ):
            places.setdefault(tuple(place), []).append((name, time_ns))
    if not any(index.sequential for index in wanted.values()):
        logged = np.unique(np.concatenate([index.log_ns for index in wanted.values()]))
        yield from _read(recording, missing, sources.layout, Extent(at_ns=logged))
    if any(missing.values()):  # video, or a wrong index
        yield from _read(recording, missing, sources.layout, EVERYTHING)


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
            stamp_ns = stamp_of(decoded, message.log_time_ns)
        except (RecordingError, *NOT_ITS_TYPE):
            continue  # without a stamp, it cannot have been selected
        wanted = missing[message.topic].pop((message.log_time_ns, stamp_ns), [])
        codec = codec_of(decoded)
        if not wanted and codec is None:
            continue
        if codec is not None and message.topic not in videos:
            videos[message.topic] = Video(codec)
        picture: GrayImage | Rejection
        try:
            picture = decode_image(decoded) if codec is None else videos[message.topic].picture(decoded)
        except RecordingError as error:
            detail = f"{message.topic}: {error.message}"
            picture = Rejection("readers", "image cannot be decoded", detail, stamp_ns)
        for name, time_ns in wanted:
            yield name, time_ns, _part(picture, name, layout)
        if not any(missing.values()):
            return


def pictures_near(
    recording: Recording, sources: Sources, times_ns: Sequence[int]
) -> Iterator[tuple[str, GrayImage | Rejection]]:
    """First image of each camera after given times (of video, first key frame), without reading the whole recording.

    Without an index, and of video, only stretches spread over the recording are read.

    Args:
        times_ns: log times, increasing.

    Yields:
        Camera, and the image as (height, width) uint8, or the reason why it cannot be decoded.
    """
    names: dict[str, list[str]] = {}
    for name, topic in sources.image.items():
        names.setdefault(topic, []).append(name)
    logged = recording.log_times()
    for topic, cameras in names.items():
        extent = Extent(_GLANCE_BYTES)
        if topic in logged and not _is_video(recording, topic):
            own = np.sort(logged[topic])
            first = np.unique(np.searchsorted(own, times_ns))
            extent = Extent(at_ns=own[first[first < len(own)]])
        for picture in _first_after(recording.messages([topic], extent), times_ns):
            for name in cameras:
                yield name, _part(picture, name, sources.layout)


def _is_video(recording: Recording, topic: str) -> bool:
    with suppress(RecordingError):
        for message in recording.messages([topic]):
            return codec_of(message.decode()) is not None
    return False


def _first_after(messages: Iterable[Message], times_ns: Sequence[int]) -> Iterator[GrayImage | Rejection]:
    """First image among a topic's messages after each time; of video, first key frame."""
    waiting = list(times_ns)
    for message in messages:
        if not waiting:
            return
        if message.log_time_ns < waiting[0]:
            continue
        video: Video | None = None
        picture: GrayImage | Rejection
        try:
            decoded = message.decode()
            codec = codec_of(decoded)
            video = None if codec is None else Video(codec)
            picture = decode_image(decoded) if video is None else video.picture(decoded)
        except RecordingError as error:
            if video is not None:  # no key frame
                continue
            picture = Rejection("readers", "image cannot be decoded", error.message, message.log_time_ns)
        waiting = [time_ns for time_ns in waiting if time_ns > message.log_time_ns]
        yield picture


def _part(picture: GrayImage | Rejection, name: str, layout: StereoLayout) -> GrayImage | Rejection:
    """One camera's part of an image, if there is one."""
    if layout == "separate" or isinstance(picture, Rejection):
        return picture
    first, second = np.array_split(picture, 2, axis=1 if layout == "side_by_side" else 0)
    return np.ascontiguousarray(first if name == "left" else second)
