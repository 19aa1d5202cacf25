"""The nine parameters: names, labels and units, and values with the digits that standard deviations justify."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mobilecal_cli.model import NINE

_MOST_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the nine parameters.

    Attributes:
        name: as in params.yaml.
        symbol: in the paper; for a rotation, the component of the rotation vector.
        label: in a summary.
        meaning: what its standard deviation is of.
        unit: "rad" or "m".
        shown_unit, factor: unit for people, and how many of it one `unit` is.
        digits: decimals to show where no standard deviation is known.
    """

    name: str
    symbol: str
    label: str
    meaning: str
    unit: str
    shown_unit: str
    factor: float
    digits: int

    @property
    def key(self) -> str:
        """Name with the unit for people, for columns of numbers."""
        return f"{self.name}_{self.shown_unit}"

    @property
    def gate(self) -> str:
        """Name of the gate on its standard deviation."""
        return f"std.{'wheels' if self.name in NINE[6:] else 'head_eye'}.{self.name}_{self.unit}"


def _rotation(axis: str) -> Parameter:
    meaning = f"small rotation about the head's {axis} axis"
    return Parameter(
        f"r_{axis}", f"r{axis}", f"rotation vector {axis}", meaning, "rad", "deg", 180 / math.pi, 3
    )


def _length(name: str, symbol: str, label: str, meaning: str = "") -> Parameter:
    return Parameter(name, symbol, label, meaning or label, "m", "mm", 1e3, 2)


PARAMETERS = (
    *(_rotation(axis) for axis in "xyz"),
    *(
        _length(f"t_{axis}", f"t{axis}", f"translation {axis}", f"camera position in the head frame, {axis}")
        for axis in "xyz"
    ),
    _length("radius_right", "rR", "right wheel radius"),
    _length("radius_left", "rL", "left wheel radius"),
    _length("separation", "b", "wheel separation"),
)
BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def value_text(value: float, std: float | None, otherwise: int, sign: str = "") -> str:
    """A value with as many decimals as its standard deviation shows.

    Args:
        value: the value.
        std: its standard deviation in the same unit; None where it is unknown.
        otherwise: decimals where there is no positive standard deviation.
        sign: "+" writes the sign of positive values too.
    """
    return f"{value:{sign}.{otherwise if std is None else decimals_of(std, otherwise)}f}"


def std_text(std: float) -> str:
    """A standard deviation or an error with two significant digits, never rounded to zero."""
    return f"{std:.1e}" if 0 < std < 10.0**-_MOST_DECIMALS else f"{std:.{decimals_of(std)}f}"


def decimals_of(std: float, otherwise: int = 3) -> int:
    """Decimals of a value that match two significant digits of its standard deviation.

    Args:
        std: the standard deviation.
        otherwise: decimals where it is zero or not finite.
    """
    if not (math.isfinite(std) and std > 0):
        return otherwise
    exponent = int(f"{std:.1e}".partition("e")[2])
    return min(max(1 - exponent, 0), _MOST_DECIMALS)
