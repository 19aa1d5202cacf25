"""Single files, written completely or not at all."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from mobilecal_cli.errors import OutputError


def check_file(path: Path, force: bool) -> None:
    """Check whether a file may be written.

    Raises:
        OutputError: the file exists and `force` is not set, or is not a regular file.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise OutputError(f"{path}: exists and is not a regular file", "choose another --output")
    if path.exists() and not force:
        raise OutputError(f"{path}: already exists", "add --force to replace it, or choose another --output")


def write_file(path: Path, content: bytes, force: bool) -> None:
    """Write a file under a temporary name next to it, then rename it.

    Raises:
        OutputError: the file exists and `force` is not set, is not a regular file, or cannot be written.
    """
    check_file(path, force)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        with partial.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        partial.replace(path)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written: {error.strerror}", "choose another --output"
        ) from error
    finally:
        partial.unlink(missing_ok=True)
