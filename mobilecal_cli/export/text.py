"""Values as text in YAML, which 1.1 and 1.2 loaders read identically, and in XML; files from templates."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import Setting
from mobilecal_cli.model.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment

_DIGITS = 13  # half a unit of the 13th digit is a relative error of at most 5e-13
_NOTHING = 1e-15  # m, degrees or a unit quaternion's component: below what double precision gives them
_PLAIN_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_.]*")
_PLAIN_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
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
    """A double-quoted scalar on one line, for any text."""
    return dump(text).removesuffix("\n")


def dump(value: Setting) -> str:
    """Block YAML of plain values; strings are quoted, so none is read as a number or a date."""
    stream = io.StringIO()
    _emitter().dump(value, stream)
    return stream.getvalue()


def _emitter() -> Any:  # noqa: ANN401  (ruamel.yaml's emitter is typed as Any itself)
    from ruamel.yaml import YAML
    from ruamel.yaml.representer import SafeRepresenter

    class Plain(SafeRepresenter):
        """Quoted strings, decimals, and no anchors for repeated values."""

        def ignore_aliases(self, data: object) -> bool:
            return True

    def text(representer: SafeRepresenter, data: str) -> Any:  # noqa: ANN401
        return representer.represent_scalar("tag:yaml.org,2002:str", data, style='"')

    def number(representer: SafeRepresenter, data: float) -> Any:  # noqa: ANN401
        return representer.represent_scalar("tag:yaml.org,2002:float", decimal(data))

    def mapping(representer: SafeRepresenter, data: dict[str, Setting]) -> Any:  # noqa: ANN401
        node = representer.represent_mapping("tag:yaml.org,2002:map", data)
        for key, _ in node.value:
            if _PLAIN_KEY.fullmatch(key.value) and key.value.lower() not in _WORDS:
                key.style = None
        return node

    Plain.add_representer(str, text)
    Plain.add_representer(float, number)
    Plain.add_representer(dict, mapping)
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = Plain
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 1 << 30  # never fold: folded strings are hard to read and to search
    return yaml


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

    The functions of this module are filters; `key` quotes a key of YAML where it has to be.
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
    filters = (attribute, comment, decimal, decimals, exponential, quoted, visible)
    environment.filters |= {each.__name__: each for each in filters}
    environment.filters["key"] = lambda name: name if _PLAIN_NAME.fullmatch(name) else quoted(name)
    return environment
