"""Kinematics of the head chain and the two wheels, with Jacobians.

Every public name of these modules is a name of the package; `urdf`, which needs an XML parser, is imported by itself.
"""

from mobilecal_cli.kinematics.head import *
from mobilecal_cli.kinematics.motion import *
from mobilecal_cli.kinematics.wheels import *
