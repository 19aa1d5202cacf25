"""mobilecal: head-eye and wheel calibration of a differential-drive robot from one recording.

Importing this package does no work; `mobilecal_cli.pipeline` is what a notebook would call.
"""

__version__ = "0.1.0"
