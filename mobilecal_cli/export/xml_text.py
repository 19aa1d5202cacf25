"""Text inside XML."""

from __future__ import annotations

from mobilecal_cli.model.text import visible


def attribute(text: str) -> str:
    """Any text as a quoted attribute value."""
    from xml.sax.saxutils import quoteattr  # loads urllib with all of its network protocols

    return quoteattr(text)


def comment(text: str) -> str:
    """Any text as the contents of an XML comment, where two hyphens are not allowed."""
    return visible(text).replace("--", "- -").replace("--", "- -")
