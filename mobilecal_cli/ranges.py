"""Physical ranges: every value that a user, a file or a message gives is checked against one of these."""

from __future__ import annotations

import math
import reprlib
from dataclasses import dataclass
from typing import SupportsFloat

from mobilecal_cli.errors import ConfigError

#: Unit → the smaller unit that it is often mistaken for, and how many of these it is.
_SMALLER = {"m": ("millimeters", 1000.0), "rad": ("degrees", 180 / math.pi), "s": ("milliseconds", 1000.0)}
#: Gate on an expected error in use (1 sigma) → default limit of the verdict, for robots of usual size.
ACCURACY = {
    "predicted.camera_mm": 20.0,
    "predicted.camera_deg": 1.0,
    "predicted.along_mm_per_m": 10.0,
    "predicted.heading_deg_per_m": 1.0,
    "predicted.heading_deg_per_turn": 5.0,
}
#: Wheel separations of robots of usual size, m.
USUAL_SEPARATION = (0.2, 0.6)


@dataclass(frozen=True, slots=True)
class Range:
    """Values that are possible for a real robot.

    Attributes:
        low, high: smallest and largest possible value.
        unit: of both, "" for numbers without one.
    """

    low: float
    high: float
    unit: str = ""

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".strip()

    def check(self, name: str, given: object, hint: str = "check the value and its unit") -> float:
        """A value, a Python or NumPy number, as a float.

        Args:
            name: of the value, for the message.
            given: the value.
            hint: what to do about a value that is out of range.

        Raises:
            ConfigError: it is no number, out of range, or NaN.
        """
        value = number_of(name, given)
        if value not in self:
            raise ConfigError(
                f"{name}: {f'{value:g} {self.unit}'.strip()} is not possible (range {self}){self._unit_of(value)}",
                hint,
            )
        return value

    def validated(self, value: float) -> float:
        """The value itself, for fields of a schema.

        Raises:
            ValueError: it is out of range, or NaN.
        """
        if value not in self:
            raise ValueError(f"must be from {self}{self._unit_of(value)}")
        return value

    def _unit_of(self, value: float) -> str:
        """What a value beyond the range looks like, "" if its unit has no smaller one or it is far beyond."""
        if self.unit in _SMALLER:
            smaller, count = _SMALLER[self.unit]
            if self.high < abs(value) <= count * self.high:
                return f"; {value:g} looks like {smaller}: {value / count:.4g} {self.unit}"
        return ""


def accuracy(gate: str, separation_m: float) -> float | None:
    """Default limit of an expected error for a robot of this wheel separation; None for no limit.

    The same wheels turn a narrow base further on each meter, and the lengths of a wide one are larger.
    """
    limit, (narrow_m, wide_m) = ACCURACY.get(gate), USUAL_SEPARATION
    times = {
        "predicted.heading_deg_per_m": narrow_m / separation_m,
        "predicted.camera_mm": separation_m / wide_m,
    }
    larger = times.get(gate, 1.0)
    return None if limit is None else limit * max(larger, 1.0)


def number_of(name: str, value: object) -> float:
    """A Python or NumPy number as a float.

    Raises:
        ConfigError: it is a text, True, an array, or anything else.
    """
    if isinstance(value, bool) or not isinstance(value, SupportsFloat) or getattr(value, "shape", ()) != ():
        raise ConfigError(f"{name}: {reprlib.repr(value)} is not a number", "give one number")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:  # such as an array of one text
        raise ConfigError(f"{name}: {reprlib.repr(value)} is not a number", "give one number") from error


WHEEL_RADIUS = Range(1e-3, 10.0, "m")
WHEEL_SEPARATION = Range(1e-2, 100.0, "m")
SQUARE = Range(1e-4, 10.0, "m")
#: A distance along an axis between two frames of one robot; tens of meters are millimeters.
POSITION = Range(-20.0, 20.0, "m")
#: A drive.
DISTANCE = Range(1e-2, 1e5, "m")
ODOMETRY_RATE = Range(1e-1, 1e4, "Hz")
ANGLE = Range(-2 * math.pi, 2 * math.pi, "rad")
#: A rotation about one axis relative to the nominal one.
TURN = Range(-math.pi, math.pi, "rad")
#: Standard deviations and noise levels in any unit of this package.
SIGMA = Range(1e-9, 1e4)
#: Noise levels that were estimated.
LEVEL = Range(0.0, 1e3)
#: The difference of a constant of the robot description from its stated value: rad, m, s or a share.
DIFFERENCE = Range(-100.0, 100.0)
#: Share of the stations that are held out.
HOLD_OUT = Range(1e-4, 0.8, "of the stations")
TICKS = Range(1.0, 1e9)
FOCAL_LENGTH = Range(1.0, 1e6, "px")
#: A reading of a joint, a counter or an odometry, rad or m.
READING = Range(-1e9, 1e9)


_OF_PARAMETER = {"r": TURN, "t": POSITION, "radius": WHEEL_RADIUS, "separation": WHEEL_SEPARATION}


def of_parameter(name: str) -> Range:
    """Range of one of the nine parameters."""
    return _OF_PARAMETER[name.partition("_")[0]]
