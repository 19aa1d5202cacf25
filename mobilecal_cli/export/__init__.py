"""Values to the files that other programs read: params.yaml, extraction.npz, and a directory of them."""

from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.export.outputs import check_output, write_outputs
from mobilecal_cli.export.params import CalibratedRobot, parameters_from_yaml, params_yaml

__all__ = [
    "CalibratedRobot",
    "check_output",
    "extraction_from_npz",
    "extraction_to_npz",
    "parameters_from_yaml",
    "params_yaml",
    "write_outputs",
]
