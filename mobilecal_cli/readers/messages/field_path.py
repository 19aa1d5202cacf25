"""Field paths: numbers in messages of any type, such as "data", "left.ticks" or "values[0]"."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import listed
from mobilecal_cli.readers.messages.equivalents import fields_of

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[\d+\])*)")


@dataclass(frozen=True, slots=True)
class FieldPath:
    """A parsed path.

    Attributes:
        text: as given by the user.
        steps: attribute names and list indices, in order.
    """

    text: str
    steps: tuple[str | int, ...]

    @classmethod
    def parse(cls, text: str) -> FieldPath:
        """Parse a path.

        Raises:
            RecordingError: not a valid path.
        """
        steps: list[str | int] = []
        for part in text.split("."):
            match = _STEP.fullmatch(part.strip())
            if match is None:
                raise RecordingError(
                    f"{text!r} is not a field path", 'use a path such as "data", "left.ticks" or "values[0]"'
                )
            steps.append(match[1])
            steps.extend(int(index) for index in re.findall(r"\[(\d+)\]", match[2]))
        return cls(text, tuple(steps))

    def number(self, message: Any, topic: str, setting: str) -> int | float:  # noqa: ANN401 - the type is the recording's
        """The number at the path.

        Args:
            message: any decoded message.
            topic, setting: topic of the message and key in rig.yaml, for error messages.

        Raises:
            RecordingError: a step is missing, or the value is not a number; the message lists the fields present.
        """
        value = message
        for step in self.steps:
            try:
                value = value[step] if isinstance(step, int) else getattr(value, step)
            except (AttributeError, IndexError, TypeError, KeyError) as error:
                raise RecordingError(
                    f"{topic}: no field {self.text} ({step!r} is missing); fields present: {listed(_paths(message))}",
                    f"correct {setting} in rig.yaml",
                ) from error
        if isinstance(value, (bool, int, np.integer)):
            return int(value)
        if isinstance(value, (float, np.floating)):
            return float(value)
        raise RecordingError(
            f"{topic}: field {self.text} is a {type(value).__name__}, not a number; "
            f"fields present: {listed(_paths(message))}",
            f"correct {setting} in rig.yaml",
        )


def _paths(value: Any, prefix: str = "") -> list[str]:  # noqa: ANN401
    """Paths to the numbers and lists in a message."""
    found: list[str] = []
    for item, inner in fields_of(value).items():
        name = f"{prefix}{item}"
        if fields_of(inner):
            found += _paths(inner, f"{name}.")
        elif isinstance(inner, (list, np.ndarray)):
            found.append(f"{name}[0..{len(inner) - 1}]" if len(inner) else f"{name}[] (empty)")
        elif isinstance(inner, (int, float, np.number)):
            found.append(name)
    return found
