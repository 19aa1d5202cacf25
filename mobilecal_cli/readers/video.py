"""H.264 and H.265 video, a frame a message (foxglove.CompressedVideo), where PyAV is installed."""

from __future__ import annotations

from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import GrayImage

#: Formats as messages state them → the codec's name.
CODECS = {"h264": "h264", "h.264": "h264", "avc": "h264", "h265": "hevc", "h.265": "hevc", "hevc": "hevc"}


def codec_of(message: Any) -> str | None:  # noqa: ANN401 - the type is the recording's
    """The codec of a message's picture, None where it is no video."""
    return CODECS.get(str(getattr(message, "format", "")).strip().lower())


class Video:
    """The decoder of one topic: frames build on those before them, so all are given to it, in order.

    Args:
        codec: one of the values of `CODECS`.
        most_pixels: larger frames are refused.

    Raises:
        RecordingError: PyAV is not installed.
    """

    def __init__(self, codec: str, most_pixels: int) -> None:
        try:
            import av
            from av.error import FFmpegError
        except ImportError as error:
            raise RecordingError(
                f"the pictures are {codec} video, and PyAV, which decodes it, is not installed",
                "pip install 'mobilecal[video]'",
            ) from error
        self._packet, self._errors = av.Packet, FFmpegError
        self._context: Any = av.CodecContext.create(codec, "r")
        self._context.options = {"max_pixels": str(most_pixels)}
        self._context.thread_count = 1  # several would hand a frame out some messages late
        self._context.flags |= av.codec.context.Flags.low_delay
        self._whole = False

    def picture(self, data: Any) -> GrayImage:  # noqa: ANN401 - bytes or an array of them
        """The frame of the next message, (height, width) uint8.

        Raises:
            RecordingError: the frame is damaged, or builds on a key frame that is not in the recording.
        """
        try:
            frames = self._context.decode(self._packet(bytes(memoryview(data))))
        except self._errors as error:
            fact = "damaged" if self._whole else "damaged, or without the key frame that it builds on"
            self._whole = False
            raise RecordingError(f"video frame {fact}: {error}", "") from error
        self._whole = self._whole or any(frame.key_frame for frame in frames)
        if not frames or not self._whole:
            raise RecordingError("video frame without the key frame that it builds on", "")
        # The first plane of the planar YUV formats that cameras send is the gray picture.
        frame = frames[-1]
        gray = frame.to_ndarray(format="gray")
        return np.asarray(gray, dtype=np.uint8)
