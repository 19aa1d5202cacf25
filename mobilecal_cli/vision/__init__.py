"""Vision: board detection, sub-pixel corners, triangulation and board poses.

Every public name of these modules is a name of the package. Other packages use only these.
"""

from mobilecal_cli.vision.agreement import *
from mobilecal_cli.vision.detection import *
from mobilecal_cli.vision.following import *
from mobilecal_cli.vision.numbering import *
from mobilecal_cli.vision.observing import *
from mobilecal_cli.vision.pose import *
from mobilecal_cli.vision.snapshot import *
from mobilecal_cli.vision.values import *
