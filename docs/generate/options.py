"""All commands with their options, from the code: `docs/generate/options.py` writes docs/reference/options.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from mobilecal_cli.commands import app

TARGET = Path(__file__).resolve().parents[1] / "reference" / "options.md"
HEAD = """\
# Options

Generated from the code by `make docs`. [Command line](cli.md) explains the commands.
"""


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


if __name__ == "__main__":
    TARGET.write_text(page(), encoding="utf-8")
    print(f"written: {TARGET.relative_to(TARGET.parents[2])}")
