"""Directories for unfinished files. A later run removes those of a process that was killed."""

from __future__ import annotations

import atexit
import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from mobilecal_cli.errors import ConfigError, ResourceError
from mobilecal_cli.files.interruption import Interrupted, uninterrupted

try:
    import fcntl
except ImportError as error:  # every command and the Python API get here before they read or write anything
    raise ConfigError(
        "mobilecal runs on Linux and macOS; this system lacks their file locks",
        "on Windows, use the Windows Subsystem for Linux (wsl --install), or a Linux container",
    ) from error

_PREFIX = "mobilecal-"
#: Directories of this process that exist.
_existing: set[Path] = set()


@contextmanager
def scratch_directory() -> Iterator[Path]:
    """A new directory for temporary files, removed at the end of the block, or at the latest with the process.

    Raises:
        ResourceError: it cannot be created.
    """
    with ExitStack() as stack:
        try:
            with uninterrupted():
                for path in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
                    with abandoned(path) as free:
                        if free:
                            shutil.rmtree(path, ignore_errors=True)
                path = stack.enter_context(temporary(_created, _remove))
        except OSError as error:
            raise _no_space(error) from error
        yield path


def _created() -> Path:
    path = Path(tempfile.mkdtemp(prefix=_PREFIX))
    _existing.add(path)
    return path


def _remove(path: Path) -> None:
    with uninterrupted():
        shutil.rmtree(path, ignore_errors=True)
        _existing.discard(path)


def remove_all() -> None:
    """Remove the directories of blocks that a signal ended before anything was responsible for them."""
    for path in tuple(_existing):
        _remove(path)


atexit.register(remove_all)


@contextmanager
def full_disk_told() -> Iterator[None]:
    """Write temporary files; a full disk is an error of its own, whatever the block works on.

    Raises:
        ResourceError: the file system is full.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise _no_space(error) from error


def _no_space(error: OSError) -> ResourceError:
    where = os.environ.get("TMPDIR") or "temporary files"
    return ResourceError(
        f"{where}: cannot be written: {error.strerror or error}",
        "free space there, or set TMPDIR to a directory with more space",
    )


@contextmanager
def temporary(create: Callable[[], Path], remove: Callable[[Path], None]) -> Iterator[Path]:
    """A new directory that is removed at the end of the block, whatever ends it.

    It is locked until then, so that no other process takes it for abandoned. `create` is called again if another
    process removes the directory before the lock.

    Raises:
        OSError: the directory cannot be created or opened.
    """
    while True:
        path = create()
        with suppress(FileNotFoundError):
            descriptor = os.open(path, os.O_RDONLY)
            with suppress(OSError):  # not every file system has locks
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            if path.exists():
                break
            os.close(descriptor)
    try:
        yield path
    finally:
        try:
            remove(path)
        except Interrupted:  # perhaps by a signal before its first step; another one does not count
            remove(path)
            raise
        finally:
            os.close(descriptor)


@contextmanager
def abandoned(path: Path) -> Iterator[bool]:
    """Whether the process that made a directory with `temporary` has ended; it stays so during the block."""
    descriptor = -1
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        free = True
    except OSError:
        free = False
    try:
        yield free
    finally:
        if descriptor >= 0:
            os.close(descriptor)
