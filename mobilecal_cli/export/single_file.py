"""Single files, written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.files.placing import already_exists, partial_of, place


def check_file(path: Path, force: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Check before the work whether a file can be written.

    Args:
        path: the file.
        force: replace an existing file.
        inputs: files and directories that the command reads.

    Raises:
        OutputError: the file exists and `force` is not set, is not a regular file, is an input or in one, or cannot be
            created.
    """
    check_parent(path)
    if os.path.lexists(path):
        recognized_file(path)
        if not force:
            raise already_exists(path)
        real = path.resolve()
        if any(real.is_relative_to(given.resolve()) for given in inputs if given is not None):
            raise OutputError(f"{path}: this command reads this file", "choose another output path")


def check_parent(path: Path) -> None:
    """Check whether something of this name can be created.

    Raises:
        OutputError: the name is too long, or its directory does not exist or cannot be written.
    """
    parent = path.parent
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # a name that is too long, or contains a zero byte
        reason = error.strerror if isinstance(error, OSError) else error
        raise OutputError(f"{path}: cannot be created: {reason}", "choose another output path") from error
    if not parent.is_dir():
        raise OutputError(f"{path}: {parent} is not a directory", "create it, or choose another output path")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write in {parent}", "choose another output path")


def write_file(path: Path, content: bytes, force: bool) -> None:
    """Write a file under a temporary name next to it, then put it in place.

    Raises:
        OutputError: see `check_file`; or writing failed.
    """
    check_file(path, force)
    try:
        with partial_of(path, recognized_file) as partial:
            write_synced(partial, content)
            place(partial, path, recognized_file, force)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written: {error.strerror}",
            "check free space and permissions, or choose another output path",
        ) from error


def write_synced(path: Path, content: bytes) -> None:
    """Write a new file, and flush it to the disk.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def recognized_file(path: Path) -> tuple[str, ...]:
    """(), if the path is a regular file.

    Raises:
        OutputError: anything else.
    """
    if path.is_symlink() or not path.is_file():
        raise OutputError(f"{path}: exists and is not a regular file", "choose another output path")
    return ()
