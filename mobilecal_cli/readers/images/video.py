"""H.264 and H.265 video, one frame per message (foxglove.CompressedVideo); requires PyAV."""

from __future__ import annotations

from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import GrayImage

#: Formats as stated in messages → name of the codec.
CODECS = {"h264": "h264", "h.264": "h264", "avc": "h264", "h265": "hevc", "h.265": "hevc", "hevc": "hevc"}


def codec_of(message: Any) -> str | None:  # noqa: ANN401 - the type is the recording's
    """Codec of a message's image, None if it is not video."""
    return CODECS.get(str(getattr(message, "format", "")).strip().lower())


class Video:
    """Decoder of one topic's video. A frame depends on earlier frames, so all are passed to it, in order.

    Args:
        codec: one of the values of `CODECS`.
        most_pixels: maximum size of a frame.

    Raises:
        RecordingError: PyAV is not installed.
    """

    def __init__(self, codec: str, most_pixels: int) -> None:
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
        self._context.options = {"max_pixels": str(most_pixels)}
        self._context.thread_count = 1  # several threads would delay frames by some messages
        self._context.flags |= av.codec.context.Flags.low_delay
        self._whole = False

    def picture(self, data: Any) -> GrayImage:  # noqa: ANN401 - bytes or an array of them
        """Frame of the next message, (height, width) uint8.

        Raises:
            RecordingError: the frame is damaged, or its key frame is not in the recording.
        """
        try:
            frames = self._context.decode(self._packet(bytes(memoryview(data))))
        except self._errors as error:
            fact = "damaged" if self._whole else "damaged, or its key frame is missing"
            self._whole = False
            raise RecordingError(f"video frame {fact}: {error}", "") from error
        self._whole = self._whole or any(frame.key_frame for frame in frames)
        if not frames or not self._whole:
            raise RecordingError("video frame without its key frame", "")
        # The first plane of the planar YUV formats that cameras send is the gray image.
        frame = frames[-1]
        gray = frame.to_ndarray(format="gray")
        return np.asarray(gray, dtype=np.uint8)
