"""Text inside XML."""

from __future__ import annotations


def attribute(text: str) -> str:
    """Text of any origin as an attribute's value, with its quotes."""
    from xml.sax.saxutils import quoteattr  # loads urllib with all of its network protocols

    return quoteattr(text)
