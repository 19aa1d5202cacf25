"""Formats of the results: JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def json_text(value: object, sort_keys: bool = True) -> str:
    """A value as JSON: the same bytes for the same values."""
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
    return value + 0.0 if isinstance(value, float) else value  # no -0.0
