"""Checks of the arguments of the Python functions: a wrong one raises an error that names it, before any work."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mobilecal_cli.errors import ConfigError

AnyPath = str | os.PathLike[str]


def require(name: str, value: object, kinds: type | tuple[type, ...], give: str) -> None:
    """Check the type of an argument; the hint says what to `give`.

    Raises:
        ConfigError: it has another type.
    """
    if not isinstance(value, kinds):
        raise ConfigError(f"{name} is {reprlib.repr(value)}, of type {type(value).__name__}", f"give {give}")


def all_of(name: str, values: Iterable[Any], kinds: type | tuple[type, ...], give: str) -> tuple[Any, ...]:
    """Values of one kind as a tuple.

    Raises:
        ConfigError: it is no list, or an item has another type.
    """
    require(name, values, Iterable, give)
    for each in (values := tuple(values)):
        require(f"an item of {name}", each, kinds, give)
    return values


def path_of(name: str, path: AnyPath) -> Path:
    """A path.

    Raises:
        ConfigError: it is neither a string nor a `pathlib.Path`.
    """
    require(name, path, (str, os.PathLike), "a path as a string or pathlib.Path")
    return Path(path)


def paths_of(name: str, paths: AnyPath | Iterable[AnyPath]) -> tuple[Path, ...]:
    """One or several paths as a tuple.

    Raises:
        ConfigError: something else than paths.
    """
    given = [paths] if isinstance(paths, str | os.PathLike) else paths
    return tuple(map(Path, all_of(name, given, (str, os.PathLike), "a path or a list of paths")))


def names_of(name: str, names: str | Iterable[str]) -> tuple[str, ...]:
    """One or several names as a tuple.

    Raises:
        ConfigError: something else than strings.
    """
    return all_of(name, [names] if isinstance(names, str) else names, str, "a name or a list of names")


def by_name(name: str, given: Mapping[Any, Any] | None) -> Mapping[str, Any]:
    """A mapping whose keys are strings; None stands for an empty one.

    Raises:
        ConfigError: something else.
    """
    if given is None:
        return {}
    require(name, given, Mapping, "a mapping from names, such as a dict")
    names_of(name, given)
    return given


def pair_of(name: str, pair: Iterable[float]) -> tuple[float, float]:
    """Two values.

    Raises:
        ConfigError: it does not have two values.
    """
    try:
        first, second = pair
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{name}: {reprlib.repr(pair)} is not a pair of numbers",
            "give the value and its standard deviation, for example (0.5, 0.002)",
        ) from error
    return first, second
