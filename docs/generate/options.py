"""From the code: `docs/generate/options.py` writes help.txt, options.md, and two tables of cli.md."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import typer

from mobilecal_cli.__main__ import HELP_COLUMNS, help_file
from mobilecal_cli.commands import app
from mobilecal_cli.export.formats import format_of
from mobilecal_cli.targets import ROBOTS, Target

TARGET = Path(__file__).resolve().parents[1] / "reference" / "options.md"
COMMANDS = TARGET.with_name("cli.md")
BEGIN, END = "<!-- formats: begin -->\n", "<!-- formats: end -->"
HEAD = """\
# Options

Generated from the code by `make docs`. [Command line](cli.md) explains the commands.
"""


def overview(program: str = "mobilecal", columns: int = HELP_COLUMNS) -> str:
    """What `--help` prints in a terminal of this width, with a margin of two columns."""
    group: Any = typer.main.get_command(app)
    return f"{group.context_class(group, info_name=program, terminal_width=columns - 2).get_help()}\n"


def page() -> str:
    """The text of docs/reference/options.md."""
    group: Any = typer.main.get_command(app)
    parts = [HEAD]
    for name in sorted(group.commands):
        command = group.commands[name]
        text = [line.strip() for line in (command.help or "").splitlines()]
        parts += [f"## `mobilecal {name}`\n", "\n".join(text), "", "| | |", "| --- | --- |"]
        parts += [f"| {_names(item)} | {_help(item)} |" for item in command.params]
        parts.append("")
    return "\n".join(parts)


def _names(item: Any) -> str:  # noqa: ANN401 - typer's own classes
    if item.param_type_name == "argument":
        return f"`{(item.metavar or item.name).upper()}`"
    value = f" {item.metavar}" if item.metavar else ""
    return ", ".join(f"`{name}{value}`" for name in (*item.opts, *item.secondary_opts))


def _help(item: Any) -> str:  # noqa: ANN401
    text = (
        (getattr(item, "help", None) or "")
        .replace("|", "\\|")
        .replace("[default: ", "(default: ")
        .replace("]", ")")
        .replace("<", "&lt;")
    )
    choices = getattr(getattr(item, "type_descriptor", None), "choices", None)
    if choices:
        names = [f"`{getattr(choice, 'value', choice)}`" for choice in choices]
        text += f" One of {', '.join(names)}."
    return text


def with_tables(page: str) -> str:
    """A page with the table of export formats between its marks, and the robots in the row of `--robot`."""
    texts = {name: " ".join((format_of(name).__doc__ or "").split()) for name in Target}
    rows = [f"| `{name}` | {text.rstrip('.')} |" for name, text in texts.items()]
    table = "\n".join(["| format | content |", "| --- | --- |", *rows, ""])
    page = page[: page.index(BEGIN) + len(BEGIN)] + table + page[page.index(END) :]
    choices = r"\|".join(ROBOTS)
    robots = "; ".join(f"`{name}`: {meaning}" for name, meaning in ROBOTS.items())
    row = f"| `--robot {choices}` | {robots} |"
    return re.sub(r"^\| `--robot .*$", lambda _: row, page, flags=re.MULTILINE)


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
    COMMANDS.write_text(with_tables(COMMANDS.read_text(encoding="utf-8")), encoding="utf-8")
    help_file().write_text(overview(), encoding="utf-8")
    print(f"written: {TARGET.relative_to(TARGET.parents[2])}")
