"""Values as text in YAML, which 1.1 and 1.2 loaders read identically, and in XML; files from templates."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.solution import Setting
from mobilecal_cli.model.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment

_DIGITS = 13  # half a unit of the 13th digit is a relative error of at most 5e-13
_NOTHING = 1e-15  # m, degrees or a unit quaternion's component: below what double precision gives them
_PLAIN_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_.]*")
_WORDS = frozenset(["y", "n", "yes", "no", "on", "off", "true", "false", "null"])  # YAML 1.1: values


def decimal(value: float) -> str:
    """A plain decimal: no exponent (YAML 1.1 reads 1e-05 as a string), no -0, at most 13 digits.

    Values under 1e-15 are written as 0.0.

    Raises:
        ValueError: the value is not finite.
    """
    if not np.isfinite(value):
        raise ValueError(f"{value} cannot be written as a decimal")
    if abs(value) < _NOTHING:
        return "0.0"
    return np.format_float_positional(value, precision=_DIGITS, fractional=False, trim="0")


def exponential(value: float) -> str:
    """A number with a decimal point and a signed exponent, as all YAML versions need it: 1.25e-06.

    Raises:
        ValueError: the value is not finite.
    """
    if not np.isfinite(value):
        raise ValueError(f"{value} cannot be written as a number")
    return np.format_float_scientific(value + 0.0, precision=9, trim="0", exp_digits=2)


def decimals(values: Iterable[float]) -> str:
    """A flow sequence of plain decimals."""
    return "[" + ", ".join(decimal(float(value)) for value in values) + "]"


def quoted(text: str) -> str:
    """A double-quoted scalar on one line, for any text: YAML has the escapes of `visible`."""
    return '"{}"'.format(visible(text.replace("\\", "\\\\").replace('"', '\\"')))


def key(name: str) -> str:
    """A key of YAML, quoted where it has to be."""
    return name if _PLAIN_KEY.fullmatch(name) and name.lower() not in _WORDS else quoted(name)


def dump(value: Setting) -> str:
    """Block YAML of plain values; strings are quoted, so none is read as a number or a date."""
    return "\n".join(_lines(value)) + "\n"


def _lines(value: Setting) -> list[str]:
    if isinstance(value, str):
        return [quoted(value)]
    if isinstance(value, float):
        return [decimal(value)]
    if not (isinstance(value, Mapping | Sequence) and value):
        return [json.dumps(value)]
    if isinstance(value, Mapping):
        return [line for name, item in value.items() for line in _entry(name, item)]
    return [f"{'  ' if k else '- '}{line}" for item in value for k, line in enumerate(_lines(item))]


def _entry(name: str, value: Setting) -> list[str]:
    lines = _lines(value)
    if isinstance(value, str) or not (isinstance(value, Mapping | Sequence) and value):
        return [f"{key(name)}: {lines[0]}"]
    indent = "  " * isinstance(value, Mapping)
    return [f"{key(name)}:", *(f"{indent}{line}" for line in lines)]


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


def rendered(template: str, **values: Any) -> str:  # noqa: ANN401  (what the template names)
    """A file from its template in a directory `templates` of this package or of `simulate`.

    The functions of this module are filters.
    """
    return _templates().get_template(template).render(values)


@cache
def _templates() -> Environment:
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(f"mobilecal_cli.{name}") for name in ("export", "simulate")]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    filters = (attribute, comment, decimal, decimals, exponential, key, quoted, visible)
    environment.filters |= {each.__name__: each for each in filters}
    return environment
