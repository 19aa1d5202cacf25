"""Safe display of text from a recording."""

from __future__ import annotations

import textwrap
import unicodedata
from collections.abc import Iterable

#: Control, format, surrogate, private, unassigned; separators of lines and paragraphs.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


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


def capitalized(text: str) -> str:
    """The text with a capital first letter; the others stay as they are."""
    return f"{text[:1].upper()}{text[1:]}"


#: Names in a message, and characters of a name; more would be unreadable.
MOST_LISTED, LONGEST_LISTED = 10, 200


def listed(names: Iterable[str], most: int = MOST_LISTED) -> str:
    """The first names, cut if they are very long, separated by commas, and how many more there are; "none" without."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    shown = [name if len(name) <= LONGEST_LISTED else f"{name[:LONGEST_LISTED]}..." for name in every[:most]]
    return f"{', '.join(shown)}{more}" if every else "none"


_WIDTH = 80  # of paragraphs on the terminal


def wrapped(text: str, start: str = "  ", indent: str = "") -> list[str]:
    """The lines of a paragraph for the terminal, escaped.

    Args:
        text: the paragraph.
        start: in front of the first line.
        indent: in front of the others; by default as wide as `start`, or two more for a short one.
    """
    indent = indent or " " * (len(start) + 2 if start.isspace() else len(start))
    # Names and options stay whole: they are copied.
    whole = textwrap.TextWrapper(
        _WIDTH, visible(start), indent, break_on_hyphens=False, break_long_words=False
    )
    return whole.wrap(visible(text))
