"""The right camera of a pair in the format of camera_calibration_parsers."""

from mobilecal_cli.export.formats.camera_info import CameraInfo


class CameraInfoRight(CameraInfo):
    """The right camera as estimated, with new R and P; only for raw images"""

    options = frozenset()
    camera = "right"
