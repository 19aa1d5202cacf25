"""What `mobilecal init` filled in, and what it leaves to the user, for the terminal."""

from __future__ import annotations

import textwrap

from mobilecal_cli.model import Draft
from mobilecal_cli.model.text import visible

_WIDTH = 96


def draft_text(draft: Draft) -> str:
    """The settings with their sources, and the list of TODOs: those that a calibration needs first."""
    lines = ["Filled in"] if draft.filled else []
    width = max((len(one.key) for one in draft.filled), default=0)
    for one in draft.filled:
        lines += _wrapped(f"  {one.key:<{width}}  ", f"{one.value} ({one.source})")
    for title, needed in (("TODO: needed for a calibration", True), ("TODO: optional", False)):
        todo = [one for one in draft.todo if one.needed == needed]
        lines += ["", title] if todo else []
        for item in todo:
            lines += _wrapped("  ", str(item))
    if draft.notes:
        lines += ["", "Notes", *(line for note in draft.notes for line in _wrapped("  ", note))]
    return "\n".join(lines).lstrip("\n") + "\n"


def _wrapped(start: str, text: str) -> list[str]:
    indent = " " * max(4, len(start))
    return textwrap.wrap(visible(text), _WIDTH, initial_indent=visible(start), subsequent_indent=indent)
