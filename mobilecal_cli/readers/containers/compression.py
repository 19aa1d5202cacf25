"""Decompression with size limits: no block may exceed its stated size."""

from __future__ import annotations

import bz2
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mobilecal_cli.readers.containers.storage import SIZE_LIMIT
from mobilecal_cli.readers.messages.channels import Payload

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

#: A chunk may always decompress to this size; to more only within the ratio below.
ALWAYS_BYTES = 2**24
#: Images and readings never compress further; a higher ratio is made to fill memory or disk.
LARGEST_RATIO = 1000


def largest_size(stored: int) -> int:
    """Largest allowed size after decompression, bytes."""
    return min(SIZE_LIMIT, max(ALWAYS_BYTES, LARGEST_RATIO * stored))


def decompress(data: bytes, method: str, size: int) -> bytes:
    """Decompressed bytes of a chunk.

    Args:
        data: as stored.
        method: "", "none", "lz4", "zstd" or "bz2".
        size: length stated by the container, bytes.

    Raises:
        ValueError: unknown method, or the length differs from the stated one.
    """
    if not 0 <= size <= largest_size(len(data)):
        raise ValueError(f"a chunk of {len(data)} bytes states a decompressed size of {size}")
    if method in ("", "none"):
        whole = data
    elif method == "lz4":
        whole = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif method == "bz2":
        whole = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
    elif method == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            whole = reader.read(size + 1)
    else:
        raise ValueError(f"unknown compression {method!r}")
    if len(whole) != size:
        raise ValueError(f"a chunk states {size} bytes, but contains {len(whole)}")
    return whole


def message_payload(payload: Payload) -> Payload:
    """A CDR payload, decompressed if rosbag2 compressed each message separately (zstd).

    No CDR payload begins like a zstd frame, because its first byte is 0.

    Raises:
        ValueError: the frame is damaged or too large.
    """
    if bytes(payload[:4]) != ZSTD_MAGIC:
        return payload
    limit = largest_size(len(payload))
    with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
        whole = reader.read(limit + 1)
    if not whole:
        raise ValueError("an empty zstd frame")
    if len(whole) > limit:
        raise ValueError(f"a message of {len(payload)} bytes decompresses to more than {limit} bytes")
    return whole


def expand(source: BinaryIO, target: Path) -> str:
    """Decompress a zstd file.

    Returns:
        "" if the file is complete, otherwise what is wrong; `target` then contains what could be decompressed.

    Raises:
        OSError: `target` cannot be written.
    """
    stored = source.seek(0, 2)
    source.seek(0)
    room = max(ALWAYS_BYTES, LARGEST_RATIO * stored)
    with target.open("wb") as sink, zstandard.ZstdDecompressor().stream_reader(source) as reader:
        while True:
            try:
                piece = reader.read(2**20)
            except zstandard.ZstdError as error:
                return str(error)
            if not piece:
                return ""
            room -= len(piece)
            if room < 0:
                return f"its {stored} bytes decompress to more than {LARGEST_RATIO} times their size"
            sink.write(piece)
