"""The commands. Each is a few lines; `main` turns errors into messages and exit codes."""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import NoReturn

from mobilecal_cli.cli import calibrating, fleet, looking, printing, simulating, using
from mobilecal_cli.cli.app import app
from mobilecal_cli.errors import MobilecalError, RecordingError, ResourceError
from mobilecal_cli.source_date import source_date

#: Error code of OpenCV.
_OPENCV_NO_MEMORY = -4

__all__ = ["app", "calibrating", "fleet", "looking", "main", "printing", "simulating", "using"]

#: The order of `mobilecal --help`: the everyday commands first.
_ORDER = (
    "calibrate",
    "init",
    "check",
    "inspect",
    "suggest",
    "evaluate",
    "compare",
    "export",
    "batch",
    "board",
    "simulate",
)
app.registered_commands.sort(key=lambda command: _ORDER.index(command.callback.__name__))  # type: ignore[union-attr]


def main() -> None:
    """Run the command line; on an error, print it and exit with its code."""
    try:
        source_date()  # before libraries are imported that read it too
        app()
    except MobilecalError as error:
        _fail(error)
    except PermissionError as error:  # of a directory on the way to a file
        hint = "check the permissions of the file and of its directories"
        _fail(RecordingError(f"{error.filename}: cannot be read: {error.strerror}", hint))
    except Exception as error:
        if not _is_out_of_memory(error):
            raise
        _fail(
            ResourceError("out of memory", "use --jobs 1, a shorter recording, or a machine with more memory")
        )


def _is_out_of_memory(error: Exception) -> bool:
    """Whether memory could not be allocated; OpenCV has its own error for it."""
    opencv = type(error).__module__ == "cv2" and getattr(error, "code", None) == _OPENCV_NO_MEMORY
    return opencv or isinstance(error, MemoryError)


def _fail(error: MobilecalError) -> NoReturn:
    from mobilecal_cli.model.text import visible  # names from a recording must not control the terminal

    with suppress(OSError):  # standard error may be full
        print(f"error: {visible(error.message)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {visible(error.hint)}", file=sys.stderr)
    sys.exit(error.exit_code)
