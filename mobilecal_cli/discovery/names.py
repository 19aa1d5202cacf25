"""Words and side in the name of a topic or joint."""

from __future__ import annotations

import re
from collections.abc import Iterable

from mobilecal_cli.model import RobotDescription, Side

_SIDES: dict[str, Side] = {"left": "left", "l": "left", "right": "right", "r": "right"}
_NUMBERED: dict[str, Side] = {"infra1": "left", "infra2": "right", "cam0": "left", "cam1": "right"}


def words(name: str) -> list[str]:
    """Lower-case words of a name: "/leftCamera/image_raw" → ["left", "camera", "image", "raw"]."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return [word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word]


def side_of(name: str) -> Side | None:
    """The side in a name, None if the name contains neither or both."""
    found = {side for word in words(name) if (side := _SIDES.get(word) or _NUMBERED.get(word))}
    return found.pop() if len(found) == 1 else None


def mirrored(name: str) -> tuple[str, ...]:
    """Words of a name without its side: equal for the two halves of a pair."""
    return tuple("*" if word in _SIDES or word in _NUMBERED else word for word in words(name))


def pairs(names: Iterable[str]) -> list[dict[Side, str]]:
    """Pairs of left and right names, sorted by the left name."""
    by_key: dict[tuple[str, ...], dict[Side, str]] = {}
    for name in sorted(names):
        side = side_of(name)
        if side is not None:
            by_key.setdefault(mirrored(name), {}).setdefault(side, name)
    return [found for found in by_key.values() if len(found) == 2]


def joint_state_names(description: RobotDescription) -> list[str]:
    """Names of all joints in the recording's joint states."""
    return sorted({name for names in description.joint_names.values() for name in names})
