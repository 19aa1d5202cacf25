"""Writers and readers of params.yaml, extraction.npz and other formats, and of output directories."""

from mobilecal_cli.export.board_print import BoardPrint, board_pdf
from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.export.formats import (
    camchain_yaml,
    camera_info_yaml,
    diff_drive_yaml,
    frame_note,
    plain_json,
    static_transform_launch,
    static_transform_yaml,
    verdict_note,
    with_verdict,
    xacro_properties,
)
from mobilecal_cli.export.improved import (
    Improved,
    ImprovedChain,
    camera_constants,
    improved_cameras,
    improved_chain,
)
from mobilecal_cli.export.odometry import OdometryCovariance, odometry_covariance, odometry_yaml
from mobilecal_cli.export.outputs import check_output, write_outputs
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml
from mobilecal_cli.export.plain import from_plain, to_plain
from mobilecal_cli.export.rectify import rectified_pair
from mobilecal_cli.export.single_file import check_file, write_file
from mobilecal_cli.export.urdf_patch import patched_urdf

__all__ = [
    "BoardPrint",
    "Improved",
    "ImprovedChain",
    "OdometryCovariance",
    "board_pdf",
    "camchain_yaml",
    "camera_constants",
    "camera_info_yaml",
    "check_file",
    "check_output",
    "diff_drive_yaml",
    "extraction_from_npz",
    "extraction_to_npz",
    "frame_note",
    "from_plain",
    "improved_cameras",
    "improved_chain",
    "odometry_covariance",
    "odometry_yaml",
    "parameters_from_yaml",
    "params_yaml",
    "patched_urdf",
    "plain_json",
    "rectified_pair",
    "static_transform_launch",
    "static_transform_yaml",
    "to_plain",
    "verdict_note",
    "with_verdict",
    "write_file",
    "write_outputs",
    "xacro_properties",
]
