"""Tables and paragraphs in Markdown."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def paragraph(text: str) -> str:
    """A paragraph, wrapped at 100 columns, with an empty line after it."""
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False) + "\n\n"
