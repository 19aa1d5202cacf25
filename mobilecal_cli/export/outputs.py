"""Files and output directories, written completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import permutations
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.files.interruption import uninterrupted
from mobilecal_cli.files.placing import Recognize, already_exists, clean_up, partial_of, place
from mobilecal_cli.files.reading import RECORDED

_ANOTHER = "choose another output path"
_MAGIC_BYTES = 16
# Files of an output directory: --force never deletes anything else.
OUTPUT_NAMES = frozenset({"params.yaml", "report.html", "report.json", "extraction.npz"})


def recognized_file(path: Path) -> tuple[str, ...]:
    """(), if the path is a regular file, no recording, and none of a calibration, which is replaced as a whole.

    Raises:
        OutputError: anything else.
    """
    regular_file(path)
    with suppress(OSError), path.open("rb") as stream:  # what cannot be read may be replaced
        if stream.read(_MAGIC_BYTES).startswith(RECORDED):
            raise OutputError(f"{path}: a recording", _ANOTHER)
    return ()


def regular_file(path: Path) -> tuple[str, ...]:
    """The same; a recording, too, where the output is one."""
    if path.is_symlink() or not path.is_file():
        raise OutputError(f"{path}: exists and is not a regular file", _ANOTHER)
    if _is_of_calibration(path):
        raise OutputError(f"{path}: a file of a calibration, which is only replaced as a whole", _ANOTHER)
    return ()


def recognized_output(directory: Path) -> tuple[str, ...]:
    """Names of the files in an output directory of mobilecal, or in an empty directory.

    Raises:
        OutputError: anything else.
    """
    return files_in(directory, "an output directory of mobilecal", _is_of_calibration)


def _is_of_calibration(path: Path) -> bool:
    """Whether a path is that of an output beside a params.yaml of mobilecal, or of this file itself."""
    params = path.with_name("params.yaml")
    if path.name not in OUTPUT_NAMES or not params.is_file():
        return False
    with params.open("rb") as stream:
        return stream.read(len(FIRST_LINE)) == FIRST_LINE.encode()


def files_in(directory: Path, what: str, is_its: Callable[[Path], bool]) -> tuple[str, ...]:
    """Names of the files in a directory.

    Args:
        what: the directory, in words.
        is_its: whether a file may be in it.

    Raises:
        OutputError: it is no directory, cannot be read, or contains something else.
    """
    if directory.is_symlink():
        raise OutputError(
            f"{directory}: a symbolic link, which would be replaced",
            f"give its target: {directory.resolve()}",
        )
    if not directory.is_dir():
        raise OutputError(f"{directory}: exists and is not a directory", _ANOTHER)
    try:
        entries = sorted(directory.iterdir())
        foreign = [
            path.name for path in entries if path.is_symlink() or not (path.is_file() and is_its(path))
        ]
    except OSError as error:
        raise OutputError(f"{directory}: cannot be read: {error.strerror}", _ANOTHER) from error
    if foreign:
        raise OutputError(
            f"{directory}: not {what}: it contains {foreign[0]!r}",
            "choose another output path, or move the directory away",
        )
    return tuple(path.name for path in entries)


def check_output(
    path: Path, force: bool, inputs: Iterable[Path | None] = (), recognize: Recognize = recognized_file
) -> None:
    """Check before the work whether an output can be written; remove what killed runs of it left.

    Args:
        path: the file or directory to create.
        force: whether an existing output may be replaced, or a file appended to.
        inputs: files and directories that the command reads.
        recognize: raises for anything that may not be replaced.

    Raises:
        OutputError: something exists there and may not be replaced, also because it is an input, in one or contains
            one; or the output cannot be created.
    """
    parent = path.parent
    if str(path) == "-":  # elsewhere it stands for standard output
        raise OutputError(
            "-: not a name for this output", "it is not written to standard output: name a file"
        )
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # a name that is too long, or contains a zero byte
        reason = error.strerror if isinstance(error, OSError) else error
        raise OutputError(f"{path}: cannot be created: {reason}", _ANOTHER) from error
    if not parent.is_dir():
        raise OutputError(f"{path}: {parent} is not a directory", "create it, or choose another output path")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write in {parent}", _ANOTHER)
    clean_up(path, recognize)
    if os.path.lexists(path):
        recognize(path)
        if not force:
            raise already_exists(path)
        real = path.resolve()
        for given in filter(None, inputs):
            if real.is_relative_to(given.resolve()) or given.resolve().is_relative_to(real):
                raise OutputError(f"{path}: this command reads {given}", _ANOTHER)
    if path.is_dir() and not os.access(path, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to replace it", _ANOTHER)


def check_apart(outputs: Mapping[str, Path | None]) -> None:
    """Check that no output of a command is another one, or inside another one.

    Args:
        outputs: option or name → path, None without this output.

    Raises:
        OutputError: two of them are at one path, or one is inside a directory that is replaced as a whole.
    """
    # Not Path.resolve(): it stops at links in a circle.
    given = [(name, path, Path(os.path.realpath(path))) for name, path in outputs.items() if path is not None]
    for (name, path, real), (other, other_path, other_real) in permutations(given, 2):
        if real == other_real:
            raise OutputError(f"{name} {path}: also the path of {other}", "choose a path of its own for each")
        if real.is_relative_to(other_real):
            raise OutputError(
                f"{name} {path}: inside {other} {other_path}, which is replaced as a whole",
                "choose a path outside of it",
            )


def write_outputs(outputs: Mapping[Path, bytes | Mapping[str, bytes]], force: bool) -> None:
    """Write files and directories, all or none.

    Args:
        outputs: path → contents; of a new directory: name → contents of its files.
        force: replace existing files and output directories of mobilecal.

    Raises:
        OutputError: see `check_output`; or writing failed.
    """

    def recognize_of(content: bytes | Mapping[str, bytes]) -> Recognize:
        if isinstance(content, Mapping):
            return recognized_output
        return regular_file if content.startswith(RECORDED) else recognized_file

    recognized = {path: recognize_of(content) for path, content in outputs.items()}
    for path, recognize in recognized.items():
        check_output(path, force, recognize=recognize)
    write_all(
        [(path, recognized[path], partial(_write, content=content)) for path, content in outputs.items()],
        force,
    )


def _write(path: Path, content: bytes | Mapping[str, bytes]) -> None:
    if isinstance(content, bytes):
        write_synced(path, content)
        return
    path.mkdir()
    for name, of_file in content.items():
        write_synced(path / name, of_file)


def write_all(outputs: Sequence[tuple[Path, Recognize, Callable[[Path], None]]], force: bool) -> None:
    """Write outputs to temporary directories next to them; put them in place once all are on the disk.

    Args:
        outputs: path, what raises for anything there that may not be replaced, and what writes it to another path.
        force: replace existing outputs.

    Raises:
        OutputError: writing failed; or an output appeared during the work.
    """
    with ExitStack() as stack:
        # Not resolve(): a link stays one, which is refused.
        targets = [Path(os.path.abspath(path)) for path, _, _ in outputs]  # noqa: PTH100
        partials = []
        for target, (path, recognize, write) in zip(targets, outputs, strict=True):
            with _writing(path):
                partials.append(stack.enter_context(partial_of(target, recognize)))
                write(partials[-1])
        with uninterrupted():
            for written, target, (path, recognize, _) in zip(partials, targets, outputs, strict=True):
                with _writing(path):
                    place(written, target, recognize, force)


def write_synced(path: Path, content: bytes) -> None:
    """Write a new file, and flush it to the disk.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def append_text(path: Path, text: str) -> None:
    """Append to a text file that other programs share, such as the summary of a CI job; create it if it is missing.

    Raises:
        OutputError: it cannot be written, or is not a regular file; the file is as it was before.
    """
    check_output(path, force=True)
    size = path.stat().st_size if os.path.lexists(path) else None
    try:
        with uninterrupted(), _writing(path), path.open("ab") as stream:
            stream.write(text.encode())
    except OutputError:
        if size is not None:
            os.truncate(path, size)
        else:
            path.unlink(missing_ok=True)
        raise


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Write a path inside the block; an `OSError` is an `OutputError`."""
    try:
        yield
    except OSError as error:
        hint = "check free space and permissions, or choose another output path"
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}", hint) from error
