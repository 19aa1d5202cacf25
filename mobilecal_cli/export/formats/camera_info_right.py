"""The right camera of the pair in the format of camera_calibration_parsers."""

from mobilecal_cli.export.formats.camera_info_left import CameraInfoLeft


class CameraInfoRight(CameraInfoLeft):
    """As `CameraInfoLeft`."""

    side = "right"
