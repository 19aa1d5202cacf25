"""Output directories, written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.export.single_file import check_parent, write_synced
from mobilecal_cli.files.placing import already_exists, clean_up, partial_of, place

# Files of an output directory: --force never deletes anything else.
OUTPUT_NAMES = frozenset({"params.yaml", "report.html", "report.json", "extraction.npz"})


def check_output(directory: Path, force: bool) -> None:
    """Check before the calibration whether `write_outputs` can write.

    Args:
        directory: the directory to create.
        force: whether an existing output directory of mobilecal may be replaced.

    Raises:
        OutputError: the directory exists and may not be replaced, or cannot be created.
    """
    target = _absolute(directory)
    check_parent(target)
    clean_up(target, recognized_output)
    if not os.path.lexists(target):
        return
    if target.is_symlink() or not target.is_dir():
        raise OutputError(f"{directory}: exists and is not a directory", "choose another --output")
    if not force:
        raise already_exists(directory)
    recognized_output(target)
    if not os.access(target, os.W_OK | os.X_OK):
        raise OutputError(f"{directory}: no permission to replace it", "choose another --output")


def write_outputs(directory: Path, files: Mapping[str, bytes], force: bool) -> None:
    """Write the files into a new directory, or change nothing.

    The files are written to a temporary directory next to it, which is put in place once all are on the disk.

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
    try:
        with partial_of(target, recognized_output) as partial:
            partial.mkdir()
            for name, content in files.items():
                write_synced(partial / name, content)
            place(partial, target, recognized_output, force)
    except OSError as error:
        raise OutputError(
            f"{directory}: cannot be written: {error.strerror or error}",
            "check free space and permissions, or choose another --output",
        ) from error


def recognized_output(directory: Path) -> tuple[str, ...]:
    """Names of the files in an output directory of mobilecal, or in an empty directory.

    Raises:
        OutputError: anything else.
    """
    if directory.is_symlink() or not directory.is_dir():
        raise OutputError(f"{directory}: exists and is not a directory", "choose another --output")
    try:
        entries = sorted(directory.iterdir())
        foreign = [
            path.name
            for path in entries
            if path.name not in OUTPUT_NAMES or path.is_symlink() or not path.is_file()
        ]
        if not foreign and entries and not _has_our_parameters(directory):
            foreign = [entries[0].name]
    except OSError as error:
        raise OutputError(
            f"{directory}: cannot be read: {error.strerror}", "choose another --output"
        ) from error
    if foreign:
        raise OutputError(
            f"{directory}: not an output directory of mobilecal: it contains {foreign[0]!r}",
            "choose another --output, or move the directory away",
        )
    return tuple(path.name for path in entries)


def _has_our_parameters(directory: Path) -> bool:
    path = directory / "params.yaml"
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(FIRST_LINE)) == FIRST_LINE.encode()


def _absolute(directory: Path) -> Path:
    # Not resolve(): a symbolic link has to stay one, because it is refused.
    return Path(os.path.abspath(directory))  # noqa: PTH100
