"""What all HTML pages have in common: everything from outside is escaped, undefined names are errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mobilecal_cli.model.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment


def environment() -> Environment:
    """The templates of this room."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def shown(value: object) -> object:
        """Every string from outside passes here, whatever the template does with it."""
        return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    return Environment(
        loader=PackageLoader("mobilecal_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=shown,
    )
