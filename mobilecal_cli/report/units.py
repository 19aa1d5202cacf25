"""The units in which people read the nine numbers."""

from __future__ import annotations

import math

from mobilecal_cli.model import NINE

#: Name of a number → its unit, and the factor from rad or m.
SHOWN = {**dict.fromkeys(NINE[:3], ("deg", 180 / math.pi)), **dict.fromkeys(NINE[3:], ("mm", 1e3))}
