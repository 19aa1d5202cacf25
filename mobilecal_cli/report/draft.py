"""What `mobilecal init` filled in, and what it leaves to the user, for the terminal."""

from __future__ import annotations

from mobilecal_cli.model import Draft
from mobilecal_cli.model.text import wrapped


def draft_text(draft: Draft) -> str:
    """The settings with their sources, and the list of TODOs: those that a calibration needs first."""
    lines = ["Filled in"] if draft.filled else []
    width = max((len(one.key) for one in draft.filled), default=0)
    for one in draft.filled:
        lines += wrapped(f"{one.value} ({one.source})", f"  {one.key:<{width}}  ")
    for title, needed in (("TODO: needed for a calibration", True), ("TODO: optional", False)):
        todo = [one for one in draft.todo if one.needed == needed]
        lines += ["", title] if todo else []
        for item in todo:
            lines += wrapped(str(item))
    if draft.notes:
        lines += ["", "Notes", *(line for note in draft.notes for line in wrapped(note))]
    return "\n".join(lines).lstrip("\n") + "\n"
