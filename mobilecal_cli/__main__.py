"""Entry point of the command; a signal ends it in the same way at any time, also during imports."""

from __future__ import annotations

import os
import signal
import sys

from mobilecal_cli import __version__

TYPE_CHECKING = False  # that of typing, which takes as long to import as all else here
if TYPE_CHECKING:
    from pathlib import Path
    from typing import TextIO

_BROKEN_PIPE = 141  # 128 + SIGPIPE, as a shell shows it for other programs
_OUTPUT = 7  # as OutputError, which is not imported this early
HELP_COLUMNS = 80  # the command-line library fills no more
#: Name of the program, by its file.
_PROGRAMS = {"__main__.py": "python -m mobilecal_cli", "mobilecal": "mobilecal"}


def main() -> None:
    """Run the command line; exit with 128 plus the number of the signal that ended it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the next imports are done: no traceback
    import errno
    import warnings

    from mobilecal_cli.files import interruption

    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # small matrices: more threads only wait for each other
    warnings.simplefilter("ignore", RuntimeWarning)  # of numbers that overflow: what is not finite is refused
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # no search for them in all packages
    _open_standard_streams()
    interruption.unwind_on_signals()
    try:
        text = _text_without_commands()
        if text is None:
            with interruption.naming_interruptions():
                from mobilecal_cli.commands import main as run

            run()
        else:
            print(text)
        sys.stdout.flush()
    except interruption.Interrupted:
        written = ", ".join(map(str, interruption.placed))
        _complain(f"interrupted: {f'written: {written}' if written else 'nothing was written'}")
        raise
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # the command-line library exits with 1
            sys.exit(_BROKEN_PIPE)
        raise
    except OSError as error:
        unwritable = errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EBADF
        if error.filename is not None or error.errno not in unwritable:
            raise
        _discard(sys.stdout)
        if error.errno == errno.EPIPE:
            sys.exit(_BROKEN_PIPE)
        _complain(f"error: standard output cannot be written: {error.strerror}")
        _complain("hint: check that standard output is open, and has free space where it goes")
        sys.exit(_OUTPUT)
    finally:
        try:
            sys.stderr.flush()
        except OSError:
            _discard(sys.stderr)


def help_file() -> Path:
    """What `mobilecal --help` prints where a line has `HELP_COLUMNS` or more; `make docs` writes it."""
    from pathlib import Path

    return Path(__file__).with_name("help.txt")


def _text_without_commands() -> str | None:
    """The text of `--help` or `--version`, if it is known without the command-line library, which starts slowly."""
    import shutil

    arguments, program = sys.argv[1:], _PROGRAMS.get(sys.argv[0].rpartition("/")[2])
    if arguments == ["--version"]:
        return f"mobilecal {__version__}"
    if arguments == ["--help"] and program and shutil.get_terminal_size().columns >= HELP_COLUMNS:
        return help_file().read_text(encoding="utf-8").removesuffix("\n").replace("mobilecal", program, 1)
    return None


def _complain(line: str) -> None:
    from contextlib import suppress

    shown = "".join(c if c.isprintable() else "?" for c in line)  # a path must not control the terminal
    with suppress(OSError):
        print(shown, file=sys.stderr)


def _discard(stream: TextIO) -> None:
    """Write nothing more to a stream: Python would try it again at its end, and exit with a code of its own."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _open_standard_streams() -> None:
    """Open what the caller closed, so that no other file takes the number of standard output or error.

    Writing to a closed standard output remains an error.
    """
    while True:
        number = os.open(os.devnull, os.O_RDWR)
        if number > 2:
            os.close(number)
            break
    if sys.stdout is None:
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_RDONLY), "w")
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115


if __name__ == "__main__":
    main()
