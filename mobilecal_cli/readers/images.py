"""Image decoding: sensor_msgs Image and CompressedImage to 8-bit gray."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import GrayImage, Layout, PictureIndex, Rejection, Side, Sources
from mobilecal_cli.readers.recording import Recording
from mobilecal_cli.readers.stamps import stamp_of
from mobilecal_cli.readers.storage import EVERYTHING, Extent
from mobilecal_cli.readers.video import Video, codec_of

#: Maximum number of pixels of an image, five times those of a large stereo camera.
LARGEST_PIXELS = 2**26
#: Bytes of a video that are read to find a few key frames.
_GLANCE_BYTES = 2**25
_COMPRESSIONS = ("JPEG", "PNG")


@dataclass(frozen=True, slots=True)
class _Encoding:
    """Storage of pixels: bytes per value, number of channels, and OpenCV's conversion to gray."""

    depth: int
    channels: int
    to_gray: int | None = None


# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
_ENCODINGS: dict[str, _Encoding] = {
    "mono8": _Encoding(1, 1),
    "8uc1": _Encoding(1, 1),
    "mono16": _Encoding(2, 1),
    "16uc1": _Encoding(2, 1),
    "rgb8": _Encoding(1, 3, cv2.COLOR_RGB2GRAY),
    "bgr8": _Encoding(1, 3, cv2.COLOR_BGR2GRAY),
    "8uc3": _Encoding(1, 3, cv2.COLOR_BGR2GRAY),
    "rgba8": _Encoding(1, 4, cv2.COLOR_RGBA2GRAY),
    "bgra8": _Encoding(1, 4, cv2.COLOR_BGRA2GRAY),
    "bayer_rggb8": _Encoding(1, 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": _Encoding(1, 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": _Encoding(1, 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": _Encoding(1, 1, cv2.COLOR_BayerGB2GRAY),
    "bayer_rggb16": _Encoding(2, 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr16": _Encoding(2, 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg16": _Encoding(2, 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg16": _Encoding(2, 1, cv2.COLOR_BayerGB2GRAY),
}


def read_images(
    recording: Recording,
    image_topics: Mapping[Side, str],
    wanted: Mapping[Side, PictureIndex],
    layout: Layout = "separate",
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
    layout: Layout,
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


def _part(picture: GrayImage, side: Side, layout: Layout) -> GrayImage:
    """One camera's part of an image."""
    if layout == "separate":
        return picture
    first, second = np.array_split(picture, 2, axis=1 if layout == "side_by_side" else 0)
    return np.ascontiguousarray(first if side == "left" else second)


def decode_image(message: Any) -> GrayImage:  # noqa: ANN401 - the type is the recording's
    """Gray image from a decoded Image or CompressedImage message.

    A 16-bit image keeps its upper byte. If no pixel uses the full range (10 or 12 bit sensors in 16-bit words), the
    image is scaled by the smallest power of two that covers its largest value.

    Args:
        message: fields as in sensor_msgs, of ROS 1 or ROS 2.

    Returns:
        (height, width) uint8; a view of the message's bytes if no conversion is necessary.

    Raises:
        RecordingError: unknown encoding, size that does not match the data, or damaged JPEG or PNG.
    """
    try:
        if hasattr(message, "format"):
            return _decompressed(message)
        return _raw(message)
    except (AttributeError, TypeError, ValueError) as error:
        raise RecordingError(f"not a sensor_msgs image: {error}", "") from error
    except cv2.error as error:
        raise RecordingError(f"image damaged: {error.err}", "") from error


def _decompressed(message: Any) -> GrayImage:  # noqa: ANN401
    data = np.frombuffer(message.data, dtype=np.uint8)
    if not data.size:
        raise RecordingError("image empty: 0 bytes", "")
    _check_claim(message.data, str(message.format))
    gray = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    if gray is None:
        raise _not_a_picture(data.size, str(message.format))
    return np.asarray(gray, dtype=np.uint8)


def _not_a_picture(size: int, kind: str) -> RecordingError:
    return RecordingError(f"image damaged: {size} bytes of {kind!r} are not a readable JPEG or PNG", "")


def _check_claim(data: Any, kind: str) -> None:  # noqa: ANN401 - bytes or an array of them
    """Check the size stated in a compressed image's header before memory for its pixels is allocated."""
    stored = bytes(memoryview(data))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a large image: it is refused below
            with Image.open(io.BytesIO(stored), formats=_COMPRESSIONS) as picture:
                width, height = picture.size
    except Image.DecompressionBombError as error:  # far above the limit below
        raise RecordingError(f"invalid image size: {error}", "") from error
    except Exception as error:  # damaged headers may raise anything
        raise _not_a_picture(len(stored), kind) from error
    if width * height > LARGEST_PIXELS:
        raise RecordingError(f"image size {width}x{height} exceeds the limit of {LARGEST_PIXELS} pixels", "")


def _raw(message: Any) -> GrayImage:  # noqa: ANN401
    encoding = _ENCODINGS.get(str(message.encoding).strip().lower())
    if encoding is None:
        raise RecordingError(
            f"unknown image encoding {message.encoding!r}; known: {', '.join(sorted(_ENCODINGS))}", ""
        )
    pixels = _pixels(message, encoding)
    if encoding.depth == 2:
        pixels = _to_8_bit(pixels)
    if encoding.to_gray is None:
        return np.asarray(pixels, dtype=np.uint8)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), encoding.to_gray), dtype=np.uint8)


def _pixels(message: Any, encoding: _Encoding) -> NDArray[Any]:  # noqa: ANN401
    """(height, width) or (height, width, channels) view of the data, respecting step and byte order."""
    height, width = int(message.height), int(message.width)
    data = np.frombuffer(message.data, dtype=np.uint8)
    row = width * encoding.channels * encoding.depth
    step = int(message.step) or row
    if not height or not width or height * width > LARGEST_PIXELS:
        raise RecordingError(f"invalid image size {width}x{height} (limit {LARGEST_PIXELS} pixels)", "")
    # The last row needs no padding after it.
    if step < row or data.size < step * (height - 1) + row:
        raise RecordingError(
            f"image size {width}x{height} {message.encoding} with {step} bytes per row does not match "
            f"its {data.size} bytes",
            "",
        )
    dtype = np.dtype(np.uint8 if encoding.depth == 1 else (">u2" if message.is_bigendian else "<u2"))
    shape: tuple[int, ...] = (height, width)
    strides: tuple[int, ...] = (step, encoding.channels * encoding.depth)
    if encoding.channels > 1:
        shape, strides = (*shape, encoding.channels), (*strides, encoding.depth)
    return np.ndarray(shape, dtype, data, 0, strides)


def _to_8_bit(pixels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    bits = max(int(pixels.max()).bit_length(), 8)
    return (pixels >> (bits - 8)).astype(np.uint8)
