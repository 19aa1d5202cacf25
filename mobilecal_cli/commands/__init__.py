"""The commands, each a function in a module of its name; `main` turns errors into messages and exit codes."""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer

from mobilecal_cli import __version__
from mobilecal_cli.calibrate import source_date
from mobilecal_cli.commands.options import add_command, remove_earlier_junit
from mobilecal_cli.errors import ConfigError, MobilecalError, OutputError, RecordingError, ResourceError
from mobilecal_cli.files.interruption import naming_interruptions

#: In the order of `mobilecal --help`: the everyday ones first.
COMMANDS = (
    *("calibrate", "init", "check", "inspect", "suggest", "evaluate", "compare"),
    *("export", "batch", "board", "simulate"),
)
#: Error code of OpenCV where memory cannot be allocated.
_OPENCV_NO_MEMORY = -4
#: A wrong command line: the class of the command-line library that has all of them, and that it does not export.
_UsageError: Any = typer.BadParameter.__base__

app = typer.Typer(
    name="mobilecal",
    help="Calibrate the cameras and the wheels of a differential-drive robot.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(requested: bool) -> None:
    if requested:
        typer.echo(f"mobilecal {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Calibrate the cameras and the wheels of a differential-drive robot from a recording of a checkerboard.

    Example: mobilecal calibrate log.mcap
    """


for name in COMMANDS:
    add_command(app, getattr(import_module(f"{__name__}.{name}"), name))


def main() -> None:
    """Run the command line; on an error, print it and exit with its code."""
    try:
        with naming_interruptions():
            source_date()  # before libraries are imported that read it too
            if "" in sys.argv[1:]:  # as a path it would be the working directory
                raise ConfigError(
                    "an argument is empty", "leave it out, or set the variable that it comes from"
                )
            code = app(standalone_mode=False)
        sys.exit(code)
    except MobilecalError as error:
        _fail(error)
    except _UsageError as error:
        remove_earlier_junit(sys.argv[1:])
        _fail(_usage_error(error))
    except PermissionError as error:  # of a directory on the way to a file
        hint = "check the permissions of the file and of its directories"
        _fail(RecordingError(f"{error.filename}: cannot be read: {error.strerror}", hint))
    except FileNotFoundError as error:
        if error.filename is not None:  # os.getcwd names none
            raise
        _fail(OutputError("the working directory does not exist any more", "change to another directory"))
    except Exception as error:
        opencv = type(error).__module__ == "cv2" and getattr(error, "code", None) == _OPENCV_NO_MEMORY
        if not (opencv or isinstance(error, MemoryError)):
            raise
        less = "use --jobs 1, a shorter recording, or a machine with more memory"
        _fail(ResourceError("out of memory", less))


def _usage_error(error: Any) -> ConfigError:  # noqa: ANN401 - see `_UsageError`
    """A wrong command line in the words of this tool; without arguments, the overview is the message."""
    from pydantic import ValidationError

    from mobilecal_cli.files.reading import problem_of

    message = error.format_message().replace("\n\t", " ")  # a list of choices
    if not sys.argv[1:]:
        with suppress(OSError):
            print(message, file=sys.stderr)
        sys.exit(error.exit_code)
    message = message[:1].lower() + message[1:]
    if isinstance(error.__cause__, ValidationError):
        item = error.__cause__.errors()[0]
        item["loc"] = (max(error.param.opts, key=len),)
        message = problem_of(item)
    command = "mobilecal" if error.ctx is None else error.ctx.command_path
    return ConfigError(message.removesuffix("."), f"see {command} --help")


def _fail(error: MobilecalError) -> NoReturn:
    from mobilecal_cli.model.text import visible  # names from a recording must not control the terminal

    with suppress(OSError):  # standard error may be full
        print(f"error: {visible(error.message)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {visible(error.hint)}", file=sys.stderr)
    sys.exit(error.exit_code)
