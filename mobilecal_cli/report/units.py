"""Display units of the nine parameters, and values with the digits that their standard deviations justify."""

from __future__ import annotations

import math

from mobilecal_cli.model import NINE
from mobilecal_cli.report.numbers import decimals_of

#: Parameter → its display unit, and the factor from rad or m.
SHOWN = {**dict.fromkeys(NINE[:3], ("deg", 180 / math.pi)), **dict.fromkeys(NINE[3:], ("mm", 1e3))}


def value_text(value: float, std: float | None, otherwise: int, sign: str = "") -> str:
    """A value with as many decimals as its standard deviation shows.

    Args:
        value: the value.
        std: its standard deviation in the same unit; None where it is unknown.
        otherwise: decimals where there is no positive standard deviation.
        sign: "+" writes the sign of positive values too.
    """
    return f"{value:{sign}.{otherwise if std is None else decimals_of(std, otherwise)}f}"
