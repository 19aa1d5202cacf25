"""Conversion of frozen dataclasses to plain JSON values and back, by their type annotations.

New fields need no change here. Those with a default value may be missing, as in data of an earlier version.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, Union

import numpy as np

T = TypeVar("T")
_SCALARS = (str, int, float, bool)
_INFINITE = "inf"  # JSON has no such number


def to_plain(value: object) -> Any:  # noqa: ANN401  (any JSON value)
    """A value as dicts, lists, strings and numbers; arrays become nested lists without loss."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): to_plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, float) and math.isinf(value):
        return _INFINITE if value > 0 else f"-{_INFINITE}"
    if value is None or isinstance(value, _SCALARS):
        return value
    raise TypeError(f"{type(value).__name__} has no plain form")


def from_plain(kind: type[T], data: object) -> T:
    """The value of a dataclass type from its plain form.

    Raises:
        ValueError: the plain form does not match the type: an extra or missing key, or another type.
    """
    return typing.cast(T, _decode(kind, data, kind.__name__))


def _decode(kind: Any, data: Any, where: str) -> Any:  # noqa: ANN401
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _decode_dataclass(kind, data, where)
    if origin is np.ndarray:
        return np.array(_expect(data, list, where), dtype=typing.get_args(arguments[1])[0])
    if origin is Literal:
        if data not in arguments:
            raise ValueError(f"{where}: {data!r} is not one of {arguments}")
        return data
    if origin in (Union, types.UnionType):
        return _decode_union(arguments, data, where)
    if origin is tuple:  # tuple[X, ...] is the only form in use
        items = enumerate(_expect(data, list, where))
        return tuple(_decode(arguments[0], item, f"{where}[{i}]") for i, item in items)
    if origin is Mapping:
        pairs = _expect(data, dict, where).items()
        return {key: _decode(arguments[1], item, f"{where}.{key}") for key, item in pairs}
    if kind is float and (type(data) is int or data in (_INFINITE, f"-{_INFINITE}")):
        return float(data)
    if type(data) is not kind:
        raise ValueError(f"{where}: {type(data).__name__} instead of {kind}")
    return data


def _decode_dataclass(kind: type, data: object, where: str) -> object:
    hints = typing.get_type_hints(kind)
    given = _expect(data, dict, where)
    if wrong := _wrong_keys(kind, given):
        raise ValueError(f"{where}: extra or missing keys: {wrong}")
    return kind(**{name: _decode(hints[name], given[name], f"{where}.{name}") for name in given})


def _wrong_keys(kind: type, given: Mapping[str, object]) -> list[str]:
    """Keys that a dataclass does not have, and fields without a default value that are missing."""
    required = {
        f.name
        for f in dataclasses.fields(kind)
        if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    }
    extra = given.keys() - {f.name for f in dataclasses.fields(kind)}
    return sorted(extra | (required - given.keys()))


def _decode_union(kinds: tuple[Any, ...], data: Any, where: str) -> Any:  # noqa: ANN401
    if data is None and type(None) in kinds:
        return None
    others = [kind for kind in kinds if kind is not type(None)]
    if len(others) > 1 and isinstance(data, dict):  # the dataclass with these fields
        fits = [
            kind
            for kind in others
            if dataclasses.is_dataclass(kind) and isinstance(kind, type) and not _wrong_keys(kind, data)
        ]
        if len(fits) != 1:
            raise ValueError(f"{where}: keys {sorted(data)} match none of {others}")
        return _decode(fits[0], data, where)
    return _decode(others[0], data, where)


def _expect(data: Any, kind: type, where: str) -> Any:  # noqa: ANN401
    if not isinstance(data, kind):
        raise ValueError(f"{where}: {type(data).__name__} instead of {kind.__name__}")  # noqa: TRY004
    return data
