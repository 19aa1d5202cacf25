"""Values to the files that other programs read: params.yaml, extraction.npz, and a directory of them."""

from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.export.outputs import check_output, write_outputs
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml
from mobilecal_cli.export.single_file import check_file, write_file

__all__ = [
    "check_file",
    "check_output",
    "extraction_from_npz",
    "extraction_to_npz",
    "parameters_from_yaml",
    "params_yaml",
    "write_file",
    "write_outputs",
]
