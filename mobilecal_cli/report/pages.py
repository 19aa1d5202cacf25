"""The Jinja environment of the HTML pages: it escapes all text and treats undefined names as errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mobilecal_cli.model.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment


def environment() -> Environment:
    """Environment with the templates of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def shown(value: object) -> object:
        """Escape control characters in every string that a template prints."""
        return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    return Environment(
        loader=PackageLoader("mobilecal_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=shown,
    )
