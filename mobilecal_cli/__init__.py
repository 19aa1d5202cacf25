"""mobilecal: head-eye and wheel calibration of a differential-drive robot from a recording.

Importing this package has no side effects. From a notebook, use `mobilecal_cli.pipeline`.
"""

__version__ = "0.1.0"
