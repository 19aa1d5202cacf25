"""A directory of outputs, written whole or not at all."""

from __future__ import annotations

import ctypes
import os
import secrets
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from mobilecal_cli.errors import OutputError

# What an output directory of ours may hold: with --force, nothing else is ever deleted.
OUTPUT_NAMES = frozenset({"params.yaml", "report.html", "report.json", "extraction.npz"})
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h
_MARKS = ("params.yaml", "report.json")


def check_output(directory: Path, force: bool) -> None:
    """Find out before the long work whether `write_outputs` could do its own.

    Args:
        directory: what is to be made.
        force: an output directory of ours that is there already may be replaced.

    Raises:
        OutputError: the directory exists (and is not ours to replace), or none can be made there.
    """
    target = _absolute(directory)
    if target.is_symlink():
        raise OutputError(f"{directory}: is a symbolic link", "name the directory itself with --output")
    if target.exists():
        _check_existing(directory, target, force)
    parent = target.parent
    if not parent.is_dir():
        raise OutputError(
            f"{directory}: {parent} is not a directory", "make it first, or choose another --output"
        )
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{directory}: no permission to write in {parent}", "choose another --output")


def write_outputs(directory: Path, files: Mapping[str, bytes], force: bool) -> None:
    """Write the files into a new directory, or leave everything as it was.

    They go into a temporary directory beside it, which is put in place once all is on the disk. An old output
    directory changes places with it in that one step, or, where the file system cannot do that, steps aside only
    then and comes back should the step fail. Killed before, the process leaves a directory `.<name>.*.partial`.

    Args:
        directory: what is made.
        files: name → contents.
        force: replace an output directory of ours.

    Raises:
        OutputError: see `check_output`; or writing failed.
    """
    foreign = sorted(files.keys() - OUTPUT_NAMES)
    if foreign:
        raise ValueError(f"not known as outputs: {foreign}")
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
        shutil.rmtree(partial, ignore_errors=True)  # gone already when all went well


def _absolute(directory: Path) -> Path:
    # Not resolve(): a symbolic link must stay one, to be refused.
    return Path(os.path.abspath(directory))  # noqa: PTH100


def _check_existing(directory: Path, target: Path, force: bool) -> None:
    if not target.is_dir():
        raise OutputError(f"{directory}: exists and is not a directory", "choose another --output")
    if not force:
        raise OutputError(
            f"{directory}: exists already", "add --force to replace it, or choose another --output"
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
            f"{directory}: does not look like an output of mobilecal: it holds {example!r}",
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
    """Have the directory's entries on the disk; some file systems cannot, and then it is not needed."""
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
    else:  # there is a moment with neither the old nor the new one in place
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
            f"{target}: written, but the directory that it replaced cannot be removed: {error.strerror}",
            f"remove {old} by hand",
        ) from error


def _exchange(first: Path, second: Path) -> bool:
    """Let two paths change places in one step; False where the system or the file system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    done = rename(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE)
    return bool(done == 0)
