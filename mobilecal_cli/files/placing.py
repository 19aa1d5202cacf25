"""Puts a finished file or directory in its place. Nothing is removed that is not recognized at that moment."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.files.interruption import placed, uninterrupted
from mobilecal_cli.files.scratch import abandoned, temporary

#: Names of the files inside an output directory, () for a file; raises OutputError for anything else.
Recognize = Callable[[Path], tuple[str, ...]]

_AT_FDCWD, _NOREPLACE, _EXCHANGE = -100, 1, 2  # linux/fcntl.h, linux/fs.h
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
_LONGEST_NAME = 200  # bytes of the target's name that the name of its temporary directory repeats
_ASIDE = "replaced"  # name in the temporary directory where two paths cannot be exchanged


@contextmanager
def partial_of(target: Path, recognize: Recognize) -> Iterator[Path]:
    """Path for the unfinished output, in a temporary directory next to the target.

    What a killed run of the same output left is removed first, or put back if it was the only copy.

    Raises:
        OSError: the directory cannot be created.
        OutputError: the output is in place, but the one that it replaced cannot be removed.
    """
    clean_up(target, recognize)
    with temporary(lambda: _created(target), lambda folder: _remove(folder, recognize)) as folder:
        yield folder / target.name
    if folder.with_suffix(".old").exists():
        raise OutputError(
            f"{target}: written, but the replaced output contains other files or cannot be removed",
            f"move away what you need from {folder.with_suffix('.old')}, and remove it",
        )


def _remove(folder: Path, recognize: Recognize) -> None:
    with uninterrupted():
        shutil.rmtree(folder, ignore_errors=True)
        _remove_replaced(folder.with_suffix(".old"), recognize)


def _created(target: Path) -> Path:
    folder = target.with_name(f"{_prefix(target)}{secrets.token_hex(4)}.partial")
    folder.mkdir()
    return folder


def place(partial: Path, target: Path, recognize: Recognize, force: bool) -> None:
    """Move a finished output from `partial_of` to its path.

    An output that it replaces is exchanged in the same step; if the file system cannot do that, it is moved aside
    first, and back if the step fails.

    Args:
        partial: the finished output.
        target: its path.
        recognize: raises for anything that may not be replaced.
        force: replace an existing output.

    Raises:
        OutputError: something exists at the path that may not be replaced.
        OSError: a move failed; nothing has changed.
    """
    with uninterrupted():
        if not _move_to_free(partial, target):
            if not force:
                raise already_exists(target)
            recognize(target)
            folder = partial.parent.with_suffix(".old")
            partial.parent.rename(folder)
            _replace(folder / partial.name, target, recognize)
        _sync(target.parent)
        placed.append(target)


def already_exists(target: Path) -> OutputError:
    """The error for an output that exists, without --force."""
    return OutputError(
        f"{target}: already exists", "add --force to replace it, or choose another output path"
    )


def _replace(partial: Path, target: Path, recognize: Recognize) -> None:
    """Exchange, and exchange back if what was there is not an output that may be replaced."""
    if _rename(partial, target, _EXCHANGE):
        try:
            recognize(partial)
        except OutputError:
            _rename(partial, target, _EXCHANGE)
            raise
        return
    aside = partial.with_name(_ASIDE)
    target.rename(aside)
    try:
        recognize(aside)
        if not _move_to_free(partial, target):
            raise already_exists(target)
    except BaseException:
        _move_to_free(aside, target)
        raise


def _move_to_free(source: Path, target: Path) -> bool:
    """Rename to a path where nothing exists; False if something does."""
    try:
        if _rename(source, target, _NOREPLACE):
            return True
        if source.is_dir():
            if os.path.lexists(target):
                return False
            source.rename(target)  # what appears now is replaced if it is an empty directory, nothing else
        else:
            os.link(source, target)
            source.unlink()
    except OSError as error:
        if error.errno not in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            raise
        return False
    return True


def _rename(source: Path, target: Path, flag: int) -> bool:
    """renameat2 with a flag; False if the system or the file system does not support it."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    if rename(_AT_FDCWD, os.fsencode(source), _AT_FDCWD, os.fsencode(target), flag) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(target))


def clean_up(target: Path, recognize: Recognize) -> None:
    """Remove what killed runs of an output left next to it."""
    names = re.compile(re.escape(_prefix(target)) + r"[0-9a-f]{8}\.(partial|old)")
    with suppress(OSError):
        for folder in [path for path in target.parent.iterdir() if names.fullmatch(path.name)]:
            with abandoned(folder) as free:
                if free and folder.suffix == ".partial":  # it contains only the new output
                    shutil.rmtree(folder, ignore_errors=True)
                elif free:
                    if not os.path.lexists(target) and (folder / _ASIDE).exists():
                        _move_to_free(folder / _ASIDE, target)
                    _remove_replaced(folder, recognize)


def _prefix(target: Path) -> str:
    return f".{os.fsdecode(os.fsencode(target.name)[:_LONGEST_NAME])}."


def _remove_replaced(folder: Path, recognize: Recognize) -> None:
    """Remove the outputs in a directory that contains a replaced one, each file by its name, and no others."""
    with suppress(OSError):
        for path in folder.iterdir():
            with suppress(OSError, OutputError):
                names = recognize(path)
                for name in names:
                    (path / name).unlink()
                path.rmdir() if path.is_dir() else path.unlink()
        folder.rmdir()


def _sync(directory: Path) -> None:
    """Flush the directory to the disk, if the file system supports it."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
