"""Safe display of text from a recording."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn"})  # control, format, surrogate, private, unassigned


def visible(text: str) -> str:
    """The text with characters that could control a terminal or a page written as escapes."""
    if text.isprintable():
        return text
    return "".join(
        character.encode("unicode_escape").decode("ascii")
        if unicodedata.category(character) in _HIDDEN
        else character
        for character in text
    )


#: Names in a message; more would be unreadable.
MOST_LISTED = 10


def listed(names: Iterable[str], most: int = MOST_LISTED) -> str:
    """The first names, separated by commas, and how many more there are; "none" without any."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return f"{', '.join(every[:most])}{more}" if every else "none"
