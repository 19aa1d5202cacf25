"""Writers and readers of params.yaml, extraction.npz and other formats, and of output directories."""

from mobilecal_cli.export.extraction import (
    THUMBNAILS,
    extraction_from_npz,
    extraction_to_npz,
    snapshots_from_npz,
)
from mobilecal_cli.export.outputs import (
    append_text,
    check_apart,
    check_appendable,
    check_file,
    check_output,
    write_file,
    write_outputs,
)
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml, with_verdict
