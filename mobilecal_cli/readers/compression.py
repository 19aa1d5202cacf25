"""Decompression with checks: no block may grow beyond what it claims."""

from __future__ import annotations

import bz2
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mobilecal_cli.readers.channels import Payload
from mobilecal_cli.readers.storage import SIZE_LIMIT

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def decompress(data: bytes, method: str, size: int) -> bytes:
    """A chunk's bytes.

    Args:
        data: as stored.
        method: "", "none", "lz4", "zstd" or "bz2".
        size: the length that the container claims, bytes.

    Raises:
        ValueError: unknown method, or the length differs from the claim.
    """
    if not 0 <= size <= SIZE_LIMIT:
        raise ValueError(f"a chunk claims {size} bytes")
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
        raise ValueError(f"a chunk claims {size} bytes and holds {len(whole)}")
    return whole


def message_payload(payload: Payload) -> Payload:
    """A CDR payload, decompressed where rosbag2 compressed it by itself (zstd).

    No CDR payload begins like a zstd frame: its first byte is 0.

    Raises:
        ValueError: the frame is damaged or too large.
    """
    if bytes(payload[:4]) != ZSTD_MAGIC:
        return payload
    with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
        whole = reader.read(SIZE_LIMIT)
    if not whole:
        raise ValueError("an empty zstd frame")
    return whole


def expand(source: BinaryIO, target: Path) -> str:
    """Decompress a zstd file.

    Returns:
        "" when it was whole, otherwise what went wrong; `target` then holds what could be read.

    Raises:
        OSError: `target` cannot be written.
    """
    with target.open("wb") as sink, zstandard.ZstdDecompressor().stream_reader(source) as reader:
        while True:
            try:
                piece = reader.read(2**20)
            except zstandard.ZstdError as error:
                return str(error)
            if not piece:
                return ""
            sink.write(piece)
