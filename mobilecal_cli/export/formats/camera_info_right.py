"""The right camera of the pair in the format of camera_calibration_parsers."""

from mobilecal_cli.export.formats.camera_info_left import CameraInfoLeft


class CameraInfoRight(CameraInfoLeft):
    """The camera as estimated, with new R and P; only for raw images"""

    side = "right"
