"""Images of a recording: a selection of them, or a few near some times; any encoding, and video, to 8-bit gray."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import GrayImage
from mobilecal_cli.model.rig import Sources, StereoLayout
from mobilecal_cli.model.signals import DEPTH_IMAGE, PictureIndex, Rejection
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent, Message
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, codec_of, stamp_of
from mobilecal_cli.readers.messages.types import Decoded

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


#: Maximum number of pixels of an image, three times those of a large stereo camera.
LARGEST_PIXELS = 2**25
_COMPRESSIONS = ("JPEG", "PNG")
#: Code of OpenCV's error.
_NO_MEMORY = -4
_JPEG = b"\xff\xd8"
_BEGIN = 12  # bytes of an image that name its format, as RIFF....WEBP
#: The encoding of the original image, which compressed_image_transport states before its own: "bayer_rggb8; png".
_BAYER_FORMAT = re.compile(r"\s*(bayer_\w+?)\s*;")

#: Encodings of distances and disparities: floats, and whole numbers with a sign.
_OF_DEPTH = re.compile(r"\s*(16S|32S|32F|64F)C", re.IGNORECASE)

Pixels = NDArray[Any]


@dataclass(frozen=True, slots=True)
class _Encoding:
    """Storage of pixels.

    Attributes:
        depth: bytes per value, 1 or 2.
        channels: values per pixel.
        to_gray: OpenCV's code of the conversion to gray; None: it is gray.
        rows: rows of the data for each row of the image; more than 1 if colors follow the gray image.
    """

    depth: int
    channels: int
    to_gray: int | None = None
    rows: float = 1.0


_BGR, _RGB = cv2.COLOR_BGR2GRAY, cv2.COLOR_RGB2GRAY
_BGRA, _RGBA = cv2.COLOR_BGRA2GRAY, cv2.COLOR_RGBA2GRAY
# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_ENCODINGS: dict[str, _Encoding] = {
    **dict.fromkeys(("mono8", "8uc1"), _Encoding(1, 1)),
    **dict.fromkeys(("mono16", "16uc1"), _Encoding(2, 1)),
    **{name: _Encoding(1, 3, way) for name, way in (("rgb8", _RGB), ("bgr8", _BGR), ("8uc3", _BGR))},
    **{name: _Encoding(2, 3, way) for name, way in (("rgb16", _RGB), ("bgr16", _BGR), ("16uc3", _BGR))},
    **{name: _Encoding(1, 4, way) for name, way in (("rgba8", _RGBA), ("bgra8", _BGRA), ("8uc4", _BGRA))},
    **{name: _Encoding(2, 4, way) for name, way in (("rgba16", _RGBA), ("bgra16", _BGRA), ("16uc4", _BGRA))},
    **{f"{name}8": _Encoding(1, 1, way) for name, way in _BAYER.items()},
    **{f"{name}16": _Encoding(2, 1, way) for name, way in _BAYER.items()},
    **dict.fromkeys(("yuv422", "uyvy"), _Encoding(1, 2, cv2.COLOR_YUV2GRAY_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuy2", "yuyv"), _Encoding(1, 2, cv2.COLOR_YUV2GRAY_YUY2)),
    **dict.fromkeys(("nv12", "nv21"), _Encoding(1, 1, rows=1.5)),
    "nv24": _Encoding(1, 1, rows=3.0),
}


def decode_image(message: Decoded) -> GrayImage:
    """Gray image from a decoded Image or CompressedImage message.

    A 16-bit image keeps its upper byte. If no pixel uses the full range (10 or 12 bit sensors in 16-bit words), the
    image is scaled by the smallest power of two that covers its largest value. Of YUV images, the Y plane is returned.
    Pixels stay where the sensor has them: an orientation in EXIF data is ignored.

    Args:
        message: fields as in sensor_msgs, of ROS 1 or ROS 2.

    Returns:
        (height, width) uint8; a view of the message's bytes if no conversion is necessary.

    Raises:
        RecordingError: unknown encoding, size that does not match the data, or damaged JPEG or PNG.
    """
    try:
        pixels, to_gray = _decompressed(message) if hasattr(message, "format") else _raw(message)
        if pixels.dtype != np.uint8:
            pixels = pixels >> (max(int(pixels.max()).bit_length(), 8) - 8)
        if to_gray is not None:
            pixels = cv2.cvtColor(np.ascontiguousarray(pixels), to_gray)
        return np.asarray(pixels, dtype=np.uint8)
    except (AttributeError, TypeError, ValueError) as error:
        raise RecordingError(f"not a sensor_msgs image: {error}") from error
    except cv2.error as error:
        if error.code == _NO_MEMORY:
            raise MemoryError(error.err) from error
        raise RecordingError(f"image damaged: {error.err}") from error


def _decompressed(message: Decoded) -> tuple[Pixels, int | None]:
    """Pixels of a JPEG or PNG as they are stored, and their conversion to gray."""
    data, kind = np.frombuffer(message.data, dtype=np.uint8), str(message.format)
    if not data.size:
        raise RecordingError("image empty: 0 bytes")
    mode = _check_header(data.tobytes(), kind)
    # A JPEG stores its gray image apart from the colors.
    is_jpeg = data[:2].tobytes() == _JPEG
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION if is_jpeg else cv2.IMREAD_UNCHANGED
    pixels = cv2.imdecode(data, flags)
    if pixels is None:
        raise _not_a_picture(data.tobytes(), kind)
    if pixels.ndim == 3:
        return pixels, _BGR if pixels.shape[2] == 3 else _BGRA
    original = _BAYER_FORMAT.match(kind.lower()) if mode[0] in "LI" else None
    encoding = _ENCODINGS.get(original[1]) if original else None
    return pixels, encoding.to_gray if encoding else None


def _not_a_picture(stored: bytes, kind: str) -> RecordingError:
    begin = stored[:_BEGIN]
    return RecordingError(
        f"image damaged, or not JPEG or PNG: {len(stored)} bytes of {kind!r} that begin with {begin!r}"
    )


def _check_header(stored: bytes, kind: str) -> str:
    """Check the size in a compressed image's header before memory for its pixels is allocated.

    Returns:
        Mode of the pixels as Pillow names it; "L" and "I" for gray ones.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a large image: it is refused below
            with Image.open(io.BytesIO(stored), formats=_COMPRESSIONS) as picture:
                (width, height), mode = picture.size, str(picture.mode)
    except Image.DecompressionBombError as error:  # far above the limit below
        raise RecordingError(f"invalid image size: {error}") from error
    except MemoryError:
        raise
    except Exception as error:  # damaged headers may raise anything
        raise _not_a_picture(stored, kind) from error
    if width * height > LARGEST_PIXELS:
        raise RecordingError(f"image size {width}x{height} exceeds the limit of {LARGEST_PIXELS} pixels")
    return mode


def _raw(message: Decoded) -> tuple[Pixels, int | None]:
    """View of an image's pixels that respects step and byte order, and their conversion to gray."""
    encoding = _ENCODINGS.get(str(message.encoding).strip().lower())
    if encoding is None:
        of = f": {DEPTH_IMAGE}" if _OF_DEPTH.match(str(message.encoding)) else ""
        raise RecordingError(f"unknown image encoding {message.encoding!r}{of}")
    height, width = int(message.height), int(message.width)
    data = np.frombuffer(message.data, dtype=np.uint8)
    row = width * encoding.channels * encoding.depth
    step = int(message.step) or row
    if not height or not width or height * width > LARGEST_PIXELS:
        raise RecordingError(f"invalid image size {width}x{height} (limit {LARGEST_PIXELS} pixels)", "")
    # The last row needs no padding after it.
    if step < row or data.size < step * (int(height * encoding.rows) - 1) + row:
        raise RecordingError(
            f"image size {width}x{height} {message.encoding} with {step} bytes per row does not match "
            f"its {data.size} bytes"
        )
    dtype = np.dtype(np.uint8 if encoding.depth == 1 else (">u2" if message.is_bigendian else "<u2"))
    shape: tuple[int, ...] = (height, width)
    strides: tuple[int, ...] = (step, encoding.channels * encoding.depth)
    if encoding.channels > 1:
        shape, strides = (*shape, encoding.channels), (*strides, encoding.depth)
    return np.ndarray(shape, dtype, data, 0, strides), encoding.to_gray


class Video:
    """Decoder of one topic's video. A frame depends on earlier frames, so all are passed to it, in order.

    Args:
        codec: see `codec_of`.

    Raises:
        RecordingError: PyAV is not installed.
    """

    def __init__(self, codec: str) -> None:
        try:
            import av
            from av.error import FFmpegError
        except ImportError as error:
            raise RecordingError(
                f"the images are {codec} video, and the decoder PyAV is not installed",
                "run pip install '.[video]' in mobilecal's source directory",
            ) from error
        self._packet, self._errors = av.Packet, FFmpegError
        self._context: Any = av.CodecContext.create(codec, "r")
        self._context.options = {"max_pixels": str(LARGEST_PIXELS)}
        self._context.thread_count = 1  # several threads would delay frames by some messages
        self._context.flags |= av.codec.context.Flags.low_delay
        self._whole = False

    def picture(self, message: Decoded) -> GrayImage:
        """Frame of the next message, (height, width) uint8.

        Raises:
            RecordingError: the frame is damaged, or its key frame is not in the recording.
        """
        try:
            frames = self._context.decode(self._packet(bytes(memoryview(message.data))))
        except self._errors as error:
            fact = "damaged" if self._whole else "damaged, or its key frame is missing"
            self._whole = False
            raise RecordingError(f"video frame {fact}: {error}") from error
        self._whole = self._whole or any(frame.key_frame for frame in frames)
        if not frames or not self._whole:
            raise RecordingError("video frame without its key frame")
        # The first plane of the planar YUV formats that cameras send is the gray image.
        return np.asarray(frames[-1].to_ndarray(format="gray"), dtype=np.uint8)
