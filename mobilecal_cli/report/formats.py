"""Formats of the results: JSON, tables for the page and the terminal, and the types that say what JSON contains.

The end of a name is the unit: `_mm`, `_deg`, `_m`, `_rad`, `_px`, `_s`, `_ns`. None, and NaN in an array, is an unknown
value.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, cast, dataclass_transform

import numpy as np
from pydantic import GetPydanticSchema

from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.text import visible

Number: TypeAlias = float | None
ByName: TypeAlias = Mapping[str, float]


def json_as(kind: Any) -> GetPydanticSchema:  # noqa: ANN401
    """For a type that is another one in the schema of JSON, such as an array."""
    return GetPydanticSchema(lambda _, handler: handler.generate_schema(kind))


#: Arrays, with what they are in JSON.
Two = Annotated[FloatArray, json_as(tuple[float, float])]
Three = Annotated[FloatArray, json_as(tuple[float, float, float])]
Four = Annotated[FloatArray, json_as(tuple[float, float, float, float])]
Row = Annotated[FloatArray, json_as(tuple[float, ...])]
NumberRow = Annotated[FloatArray, json_as(tuple[Number, ...])]
Matrix = Annotated[FloatArray, json_as(tuple[tuple[float, ...], ...])]
NumberMatrix = Annotated[FloatArray, json_as(tuple[tuple[Number, ...], ...])]
BoolMatrix = Annotated[BoolArray, json_as(tuple[tuple[bool, ...], ...])]

_T = TypeVar("_T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
class JsonValue:
    """A value for JSON: its subclasses are frozen dataclasses, whose fields are given by name."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True, eq=False)(cls)


def by(source: Callable[[Any], Any]) -> Any:  # noqa: ANN401
    """A field of a `JsonValue` that is a function of the first source of `like`."""
    return field(metadata={"by": source})


#: Unit at the end of a name → that of the code, and how many of it one of that is.
_UNITS = {"mm": ("m", 1e3), "deg": ("rad", 180 / math.pi)}


def like(cls: type[_T], *sources: object, **more: Any) -> _T:  # noqa: ANN401
    """A value whose fields are as given, by their function of the first source, or as in the first source with this
    name, also with the unit of the code in place of the one for people ("turn_deg" from `turn_rad`).
    """
    for each in fields(cls):  # type: ignore[arg-type]
        if each.name not in more:
            of = each.metadata.get("by")
            more[each.name] = of(sources[0]) if of else _value_of(sources, each.name)
    return cls(**more)


def _value_of(sources: Sequence[object], name: str) -> Any:  # noqa: ANN401
    stem, _, unit = name.rpartition("_")
    in_code, factor = _UNITS.get(unit, ("", 1.0))
    for source in sources:
        if hasattr(source, name):
            return getattr(source, name)
        if hasattr(source, f"{stem}_{in_code}"):
            return factor * getattr(source, f"{stem}_{in_code}")
    raise AttributeError(name)


def json_text(value: object, sort_keys: bool = True) -> str:
    """A value as JSON: the same bytes for the same values. Numbers that are not finite are unknown values."""
    return json.dumps(_plain(value), indent=1, sort_keys=sort_keys, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:  # noqa: ANN401  (JSON is what it is)
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None  # no -0.0
    return value


Kind = Literal["text", "number", "code", "name", "strong", "tag"]


class Table(JsonValue):
    """A table of the page, formatted; a column is text, a number, code, a name, the result ("strong") or a tag."""

    section: str
    title: str
    note: str
    heads: tuple[tuple[str, Kind], ...]
    rows: tuple[tuple[str, ...], ...]

    @classmethod
    def of(
        cls,
        heads: Sequence[str],
        rows: Sequence[tuple[str, ...]],
        section: str = "",
        title: str = "",
        note: str = "",
    ) -> Table:
        """A table in a section of the page, with a heading and a note above it.

        The heads are the labels of the columns, each with its kind in front ("number:1 sigma"). Columns without any
        text are left out.
        """
        columns = [
            (head, cells) for head, cells in zip(heads, zip(*rows, strict=True), strict=False) if any(cells)
        ]
        kinds = ((kind or "text", label) for kind, _, label in (head.rpartition(":") for head, _ in columns))
        return cls(
            section=section,
            title=title,
            note=note,
            heads=tuple((label, cast(Kind, kind)) for kind, label in kinds),
            rows=tuple(zip(*(cells for _, cells in columns), strict=True)),
        )

    def lines(self) -> list[str]:
        """The table for the terminal, escaped: each column as wide as its cells, numbers with their points aligned."""
        rows = [[visible(cell) for cell in row] for row in ([label for label, _ in self.heads], *self.rows)]
        lines = [""] * len(rows)
        for k, (_, kind) in enumerate(self.heads):
            column, side = [row[k] for row in rows], "<"
            if kind in ("number", "strong"):
                column, side = [column[0], *_points_aligned(column[1:])], ">"
            wide = max(map(len, column))
            lines = [f"{line}  {cell:{side}{wide}}" for line, cell in zip(lines, column, strict=True)]
        return [line.rstrip() for line in lines if line.strip()]

    def markdown(self) -> list[str]:
        """The table as Markdown."""
        heads = tuple(label for label, _ in self.heads)
        first, *others = (f"| {' | '.join(map(markdown, row))} |" for row in (heads, *self.rows))
        return [first, f"|{' --- |' * len(heads)}", *others]


def _points_aligned(numbers: Sequence[str]) -> list[str]:
    """Texts of numbers with spaces after them, so that their decimal points are aligned if their ends are."""
    decimals = [len(point + after) for _, point, after in (number.partition(".") for number in numbers)]
    most = max(decimals, default=0)
    return [number + " " * (most - own) for number, own in zip(numbers, decimals, strict=True)]


def markdown(text: str) -> str:
    """Text of a recording for Markdown: no markup, no new column."""
    return visible(text).translate({ord(character): f"\\{character}" for character in "\\|*_`<>[]"})
