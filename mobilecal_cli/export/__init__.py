"""Writers and readers of params.yaml, extraction.npz and other formats, and of output directories.

Every public name of these modules is a name of the package; `board_print` and `formats` are imported by themselves.
"""

from mobilecal_cli.export.extraction import *
from mobilecal_cli.export.outputs import *
from mobilecal_cli.export.params import *
