"""The data types that the stages exchange: frozen dataclasses with checked shapes and read-only arrays.

Every public name of these modules is a name of the package.
"""

from mobilecal_cli.model.arrays import *
from mobilecal_cli.model.calibration import *
from mobilecal_cli.model.findings import *
from mobilecal_cli.model.observations import *
from mobilecal_cli.model.rig import *
from mobilecal_cli.model.robot_description import *
from mobilecal_cli.model.signals import *
from mobilecal_cli.model.solution import *
from mobilecal_cli.model.text import *
