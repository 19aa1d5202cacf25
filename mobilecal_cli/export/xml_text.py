"""Text inside XML."""

from __future__ import annotations

import re

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.text import visible

_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def attribute(text: str) -> str:
    """A text as a quoted attribute value.

    Raises:
        ConfigError: it contains characters that XML does not have, such as control characters.
    """
    from xml.sax.saxutils import quoteattr  # loads urllib with all of its network protocols

    if _NOT_XML.search(text):
        raise ConfigError(
            f"the name {visible(text)!r} contains characters that XML does not allow", "rename the frame"
        )
    return quoteattr(text)


def comment(text: str) -> str:
    """Any text as the contents of an XML comment, where two hyphens are not allowed."""
    return visible(text).replace("--", "- -").replace("--", "- -")
