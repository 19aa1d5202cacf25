"""Reading of untrusted files: regular ones, within limits of size; of YAML, plain values within limits of depth."""

from __future__ import annotations

import codecs
import errno
import re
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from mobilecal_cli.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

#: More than any configuration or metadata.yaml needs; the parser takes seconds for it.
LARGEST_BYTES = 2**17
#: First bytes of a recording: MCAP, ROS 1 bag, SQLite, or any of them compressed.
RECORDED = (b"\x89MCAP0\r\n", b"#ROSBAG V", b"SQLite format 3\0", b"\x28\xb5\x2f\xfd")
_MOST_VALUES = 100_000
_DEEPEST = 100


def load_yaml(text: str) -> Any:  # noqa: ANN401 - what a file holds is known when it is read
    """Plain values of a YAML text: numbers, strings, lists, dictionaries. Tags for other objects are errors.

    Raises:
        ValueError: not YAML, too long, too deep, or anchors that expand to too many values.
    """
    if len(text) > LARGEST_BYTES:
        raise ValueError(f"{len(text)} characters (limit {LARGEST_BYTES})")
    try:
        value = YAML(typ="safe", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
        said = (error.problem or error.context or "not understood").partition(" with value ")[0]
        raise ValueError(f"{where}{' '.join(said.split())}") from error
    except RecursionError as error:
        raise ValueError(f"nested deeper than {_DEEPEST} levels") from error
    except (YAMLError, OverflowError, TypeError) as error:
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error
    _count(value, 0, {})
    return value


def mapping_of(text: str, name: str, hint: str) -> dict[str, Any]:
    """Keys and values of a YAML file; none of an empty one. `name` and `hint` are for messages.

    Raises:
        ConfigError: not YAML, see `load_yaml`, or no mapping of keys.
    """
    try:
        data = load_yaml(text)
    except ValueError as error:
        raise ConfigError(f"{name}: not valid YAML: {error}", hint) from error
    if data is not None and not isinstance(data, dict):
        raise ConfigError(f"{name}: the top level is a {type(data).__name__}, not a mapping of keys", hint)
    return data or {}


def read_bytes(
    path: Path, largest_bytes: int, hint: str = "check the path", kind: str = "text file"
) -> bytes:
    """Contents of a small file.

    Args:
        kind: what is expected; a file of this name in or beside the path is what the hint of a wrong file names.

    Raises:
        ConfigError: it cannot be read, is not a regular file (a directory, a device, a pipe), is a recording, or is too
            long.
    """
    try:
        near = next((p for p in (path / kind, path.parent / kind) if p != path and p.is_file()), None)
        instead = hint if near is None else f"give {near}"
        if path.is_dir():
            raise ConfigError(f"{path}: a directory, not a {kind}", instead)
        if not path.is_file():
            path.stat()  # raises if nothing exists there
            raise OSError(errno.EINVAL, "not a regular file")
        with path.open("rb") as stream:
            data = stream.read(largest_bytes + 1)
    except (OSError, ValueError) as error:  # a path with a zero byte is a wrong value
        cure = "check its permissions" if isinstance(error, PermissionError) else hint
        raise ConfigError(
            f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}", cure
        ) from error
    if data.startswith(RECORDED):
        raise ConfigError(f"{path}: a recording, not a {kind}", hint)
    if len(data) > largest_bytes:
        raise ConfigError(f"{path}: larger than {largest_bytes} bytes, so not a {kind}", instead)
    return data


def read_text(path: Path, largest_bytes: int, hint: str = "check the path", kind: str = "text file") -> str:
    """Contents of a text file.

    Raises:
        ConfigError: see `read_bytes`, or not UTF-8.
    """
    data = read_bytes(path, largest_bytes, hint, kind)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        where = "but UTF-16" if utf_16 else f"byte {error.start}"
        raise ConfigError(f"{path}: not UTF-8 text ({where})", f"save it as UTF-8, or {hint}") from error


#: Words of pydantic → those of this tool; reasons behind a comma repeat the value.
_WORDS = {
    "Value error, ": "",
    "Input should be": "must be",
    "Field required": "missing",
    "Extra inputs are not permitted": "unknown key",
    "Keys should be strings": "not a key",
    "a valid boolean": "true or false",
    "a valid tuple": "a list",
    "Tuple should": "must",
    " after validation": "",
}


def problem_of(item: ErrorDetails) -> str:
    """One error of a schema: the dotted key, what is wrong, and the value."""
    key = ".".join(str(part) for part in item["loc"]) or "the file"
    said = item["msg"].partition(", unable")[0]
    for words, plain in _WORDS.items():
        said = said.replace(words, plain)
    value = reprlib.repr(item["input"])
    got = "" if isinstance(item["input"], Mapping) or value in said else f" (got {value})"
    # In {square_m: 0,08}, the 08 is a key.
    comma = item["type"] == "invalid_key" or key.endswith("[key]") or re.fullmatch(r"'[-+]?\d+,\d+'", value)
    return f"{key}: {said}{got}{'; write numbers with a decimal point' if comma else ''}"


def problems_of(error: ValidationError) -> str:
    """All errors of a schema; not the number of items where one of them has an error, as pydantic leaves it out."""
    items = error.errors()
    wrong = {item["loc"][:length] for item in items for length in range(len(item["loc"]))}
    told = (item for item in items if item["type"] != "too_short" or item["loc"] not in wrong)
    return "; ".join(map(problem_of, told))


def _count(value: object, depth: int, known: dict[int, int]) -> int:
    """Number of values in a tree. Each use of an anchor counts, as if it were written out."""
    if depth > _DEEPEST:
        raise ValueError(f"nested deeper than {_DEEPEST} levels, or an anchor that contains itself")
    if not isinstance(value, (dict, list)):
        return 1
    if id(value) not in known:
        items = [*value.keys(), *value.values()] if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_count(item, depth + 1, known) for item in items)
    if known[id(value)] > _MOST_VALUES:
        raise ValueError(f"anchors that expand to more than {_MOST_VALUES} values")
    return known[id(value)]
