"""What several commands share: options and their completion, the verdict at the end, the JUnit file.

Args:
    logs: Recordings of one robot: MCAP, rosbag2, .db3 or ROS 1 .bag.
    config: Configuration (rig.yaml); `mobilecal init` drafts one.
    setting: Override rig.yaml, for example wheels.left.sign=-1. Repeatable.
    gate: Exit with code 6 if the figure is outside its limit, an upper or a lower one. Repeatable.
    as_json: Print JSON instead of text.
    junit: Also write every criterion to this file as JUnit XML.
    force: Replace existing output.
    verbose: Print every figure and check; on standard error, each stage.
    quiet: Print no progress and no summary.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args, get_origin

import typer
from typer import Argument, Option

from mobilecal_cli.errors import ConfigError, MobilecalError, OutputError, QualityError

if TYPE_CHECKING:
    from mobilecal_cli.report.inspection import Inspection
    from mobilecal_cli.report.verdict import Verdict
    from mobilecal_cli.rig.config import RigConfig

_COUNTS = re.compile("([0-9]{1,9})x([0-9]{1,9})", re.IGNORECASE)
#: A parameter in the `Args` of a docstring, and its text.
_DESCRIBED = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)
#: Parameter → the name of its option, if that is another one; and its second, short name.
_LONG = {"as_json": "--json", "open_report": "--open"}
_SHORT = {"config": ["-c"], "output": ["-o"], "quiet": ["-q"], "verbose": ["-v"]}
_LONGEST_SHOWN = 40  # characters of a text that is refused


def gate_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Figures that `--gate` of this command can limit, each with "="."""
    from mobilecal_cli.report.verdict import gate_metrics

    names = gate_metrics(evaluating=ctx.info_name == "evaluate")
    return [f"{name}=" for name in names if name.startswith(incomplete)]


def setting_keys(incomplete: str) -> list[tuple[str, str]]:
    """Keys of rig.yaml, each with "=", and their descriptions."""
    from mobilecal_cli.likelihood.constants import KINDS
    from mobilecal_cli.rig.config import setting_keys

    keys = dict(setting_keys())
    keys |= {f"priors.{kind.name}": f"{kind.meaning}, {kind.shown_unit}" for kind in KINDS}
    return [(f"{key}=", text) for key, text in keys.items() if key.startswith(incomplete)]


def add_command(app: typer.Typer, command: Callable[..., None]) -> None:
    """Add a command to the command line.

    Its docstring is its help, and under `Args` that of its parameters; the docstring of this module has that of common
    ones. Without a default, a parameter is an argument. A switch has no negative form. Typer checks no path: the
    messages of the commands say what to do.
    """
    about, _, described = (inspect.getdoc(command) or "").partition("\n\nArgs:\n")
    texts = dict(_DESCRIBED.findall(f"{__doc__}\n{described}"))
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        stated = parameter.annotation
        kind, *given = get_args(stated) if get_origin(stated) is Annotated else (stated,)
        names = [_LONG.get(name, f"--{name.replace('_', '-')}"), *_SHORT.get(name, ())]
        usual = Argument() if parameter.default is parameter.empty else Option(*names)
        info = copy(given[0]) if given else usual
        info.help, info.readable = info.help or " ".join(texts.get(name, "").split()), False
        command.__annotations__[name] = Annotated[kind, info]
    app.command(help=about)(command)


Settings = Annotated[list[str] | None, Option("--set", metavar="KEY=VALUE", autocompletion=setting_keys)]
Gates = Annotated[list[str] | None, Option("--gate", metavar="NAME=LIMIT", autocompletion=gate_names)]


def rig_of(config: Path | None, settings: list[str] | None) -> RigConfig:
    """The configuration of --config, overridden by the settings of --set.

    Raises:
        ConfigError: see `load_rig` and `parse_settings`.
    """
    from mobilecal_cli.rig.config import load_rig, parse_settings

    return load_rig(config, parse_settings(settings or []))


def counts_of(option: str, text: str) -> tuple[int, int]:
    """Columns and rows of inner corners, from "9x6".

    Raises:
        ConfigError: another text.
    """
    match = _COUNTS.fullmatch(text)
    if match is None:
        given = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
        raise ConfigError(
            f"{option} {given}: not of the form COLUMNSxROWS",
            f"count the inner corners, for example {option} 9x6",
        )
    return int(match[1]), int(match[2])


def remove_earlier_junit(arguments: Sequence[str]) -> None:
    """Remove the JUnit files that a wrong command line names: an earlier run wrote them."""
    named = [value for option, value in pairwise(arguments) if option == "--junit"]
    named += [text.removeprefix("--junit=") for text in arguments if text.startswith("--junit=")]
    if named:
        from mobilecal_cli.report.junit import is_junit

        with suppress(OSError):  # the wrong command line is what the user has to hear of
            for path in filter(is_junit, map(Path, named)):
                path.unlink()


@contextmanager
def junit_file(
    junit: Path | None,
    logs: Sequence[Path],
    force: bool,
    others: Sequence[Path | None],
    outputs: Mapping[str, Path | None] | None = None,
) -> Iterator[Callable[[bytes], None]]:
    """Function that writes the JUnit file, if there is one; an error of the command is written to it, too.

    The file of an earlier run is removed at once: it must not be read as the result of this one, whatever ends it.

    Args:
        junit: this file.
        logs: inputs of the command.
        force: whether an existing file may be replaced; one that mobilecal wrote always is.
        others: more inputs.
        outputs: option or name → path of each other output of the command.
    """
    from mobilecal_cli.export.outputs import check_apart, check_output, write_outputs
    from mobilecal_cli.report.junit import is_junit, junit_error_xml

    check_apart({"--junit": junit, **(outputs or {})})
    if junit is not None:
        force = force or is_junit(junit)
        check_output(junit, force, [*logs, *others])
        junit.unlink(missing_ok=True)

    def write(content: bytes) -> None:
        if junit is not None:
            write_outputs({junit: content}, force)

    try:
        yield write
    except MobilecalError as error:
        with suppress(OutputError):  # the first error counts
            write(junit_error_xml(str(logs[0]), error))
        raise


def conclude(
    verdict: Verdict,
    *,
    written: Sequence[Path] = (),
    quiet: bool = False,
    exit_code: int = QualityError.exit_code,
) -> None:
    """Print the verdict on standard output.

    Args:
        verdict: PASS or another one.
        written: the files written.
        quiet: print nothing on standard output (--quiet, --json), and a failure on standard error.
        exit_code: where the level is not PASS.

    Raises:
        Exit: with that code, as the level is not PASS.
    """
    from mobilecal_cli.commands.terminal import verdict_text

    passed = verdict.level == "PASS"
    if not quiet or not passed:
        typer.echo(verdict_text(verdict, to_stderr=quiet), err=quiet)
        if written:
            typer.echo(written_line(*written), err=quiet)
    if not passed:
        raise typer.Exit(exit_code)


def written_line(*paths: Path) -> str:
    """The line that says which files were written; their names must not control the terminal."""
    from mobilecal_cli.model.text import visible

    return f"Written: {visible(', '.join(map(str, paths)))}"


def show_each(inspections: Sequence[Inspection], shown: Callable[[Inspection], str], as_json: bool) -> None:
    """Print one recording after another, in JSON as a list if there are several; end with the largest exit code."""
    texts = [shown(each) for each in inspections]
    if as_json and len(texts) > 1:
        typer.echo(f"[\n{','.join(texts)}]")
    else:
        typer.echo("\n".join(texts), nl=False)
    code = max(each.exit_code for each in inspections)
    if code:
        raise typer.Exit(code)
