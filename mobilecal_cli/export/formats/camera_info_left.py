"""The left camera of a pair in the format of camera_calibration_parsers."""

from mobilecal_cli.export.formats.camera_info import CameraInfo


class CameraInfoLeft(CameraInfo):
    """The left camera as estimated, with new R and P; only for raw images"""

    options = frozenset()
    camera = "left"
