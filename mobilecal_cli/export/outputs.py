"""Output directories, written completely or not at all."""

from __future__ import annotations

import ctypes
import os
import secrets
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from mobilecal_cli.errors import OutputError

# Files of an output directory: --force never deletes anything else.
OUTPUT_NAMES = frozenset({"params.yaml", "report.html", "report.json", "extraction.npz"})
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h
_MARKS = ("params.yaml", "report.json")


def check_output(directory: Path, force: bool) -> None:
    """Check before the calibration whether `write_outputs` can write.

    Args:
        directory: the directory to create.
        force: whether an existing output directory of mobilecal may be replaced.

    Raises:
        OutputError: the directory exists and may not be replaced, or cannot be created.
    """
    target = _absolute(directory)
    if target.is_symlink():
        raise OutputError(f"{directory}: is a symbolic link", "give the directory itself with --output")
    if target.exists():
        _check_existing(directory, target, force)
    parent = target.parent
    if not parent.is_dir():
        raise OutputError(
            f"{directory}: {parent} is not a directory", "create it, or choose another --output"
        )
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{directory}: no permission to write in {parent}", "choose another --output")


def write_outputs(directory: Path, files: Mapping[str, bytes], force: bool) -> None:
    """Write the files into a new directory, or change nothing.

    The files are written to a temporary directory next to it, which is renamed once all are on the disk. An old
    output directory is exchanged in the same step; if the file system cannot do that, it is renamed first, and
    renamed back if the step fails. A process that is killed before leaves a directory `.<name>.*.partial`.

    Args:
        directory: the directory to create.
        files: name → contents.
        force: replace an existing output directory of mobilecal.

    Raises:
        OutputError: see `check_output`; or writing failed.
    """
    foreign = sorted(files.keys() - OUTPUT_NAMES)
    if foreign:
        raise ValueError(f"unknown output files: {foreign}")
    check_output(directory, force)
    target = _absolute(directory)
    partial = _free_name(target, "partial")
    try:
        partial.mkdir()
        for name, content in files.items():
            _write(partial / name, content)
        _sync(partial)
        _put_in_place(partial, target)
    except OSError as error:
        raise OutputError(
            f"{directory}: cannot be written: {error.strerror or error}",
            "check free space and permissions, or choose another --output",
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)  # does not exist after success


def _absolute(directory: Path) -> Path:
    # Not resolve(): a symbolic link has to stay one, because it is refused.
    return Path(os.path.abspath(directory))  # noqa: PTH100


def _check_existing(directory: Path, target: Path, force: bool) -> None:
    if not target.is_dir():
        raise OutputError(f"{directory}: exists and is not a directory", "choose another --output")
    if not force:
        raise OutputError(
            f"{directory}: already exists", "add --force to replace it, or choose another --output"
        )
    try:
        entries = sorted(target.iterdir())
    except OSError as error:
        raise OutputError(
            f"{directory}: cannot be read: {error.strerror}", "choose another --output"
        ) from error
    held = [entry.name for entry in entries]
    foreign = [entry.name for entry in entries if entry.name not in OUTPUT_NAMES or not entry.is_file()]
    if foreign or (held and not any(mark in held for mark in _MARKS)):
        example = (foreign or held)[0]
        raise OutputError(
            f"{directory}: not an output directory of mobilecal: it contains {example!r}",
            "choose another --output, or move the directory away",
        )
    if not os.access(target, os.W_OK | os.X_OK):
        raise OutputError(f"{directory}: no permission to replace it", "choose another --output")


def _free_name(target: Path, purpose: str) -> Path:
    return target.with_name(f".{target.name}.{secrets.token_hex(4)}.{purpose}")


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _sync(directory: Path) -> None:
    """Flush the directory to the disk, if the file system supports it."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _put_in_place(partial: Path, target: Path) -> None:
    if not target.exists():
        partial.rename(target)
        _sync(target.parent)
        return
    old = _free_name(target, "old")
    if _exchange(partial, target):
        partial.rename(old)
    else:  # for a moment, neither directory is in place
        target.rename(old)
        try:
            partial.rename(target)
        except BaseException:
            old.rename(target)
            raise
    _sync(target.parent)
    try:
        shutil.rmtree(old)
    except OSError as error:
        raise OutputError(
            f"{target}: written, but the replaced directory cannot be removed: {error.strerror}",
            f"remove {old}",
        ) from error


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two paths in one step; False if the system or the file system does not support it."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    done = rename(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE)
    return bool(done == 0)
