"""The left camera of a pair in the format of camera_calibration_parsers."""

from mobilecal_cli.export.formats import Exported, Source, camera_info


def export(of: Source) -> Exported:
    """The left camera as estimated, with new R and P; only for raw images"""
    return camera_info.export(of, "left")
