"""Time of a message: its header stamp, or the log time; and what an image message contains beside it."""

from __future__ import annotations

from typing import Any


def header_stamp_ns(message: Any) -> int | None:  # noqa: ANN401 - the type is the recording's
    """Header stamp of a message, ns; of a TFMessage, that of its first transform. None without a header."""
    if getattr(message, "transforms", None):
        message = message.transforms[0]
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return None if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def stamp_of(message: Any, log_ns: int) -> int:  # noqa: ANN401
    """Header stamp of a message, ns; the log time if there is no header or its stamp is zero."""
    return header_stamp_ns(message) or log_ns


def content_of(message: Any) -> bytes:  # noqa: ANN401
    """Pixels of an image message, as encoded; b"" without any."""
    try:
        return bytes(memoryview(message.data))
    except (AttributeError, TypeError):  # no data, or not bytes
        return b""
