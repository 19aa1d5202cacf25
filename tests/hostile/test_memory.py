"""A machine without enough memory: the command says so."""

import pytest

from tests.command import python

#: The command, with little more memory than its libraries need; the first argument is how much, MB.
_LIMITED = """
import resource, sys
from pathlib import Path
import numpy as np, scipy.optimize, mobilecal_cli.calibrate.load, mobilecal_cli.report
from mobilecal_cli.commands import main
np.linalg.lstsq(np.eye(400), np.eye(400), rcond=None)  # OpenBLAS would end the process without its memory
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + int(sys.argv.pop(1)) * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
main()
"""


@pytest.mark.parametrize("megabytes", [pytest.param(1, marks=pytest.mark.long), 4])
def test_out_of_memory(sample_logs, tmp_path, megabytes):
    arguments = ["calibrate", sample_logs / "paper_robot.mcap", "-o", "out", "--jobs", "1"]
    result = python("-c", _LIMITED, megabytes, *arguments, cwd=tmp_path)
    assert result.returncode == 8, result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.endswith(
        "error: out of memory\nhint: use --jobs 1, a shorter recording, or a machine with more memory\n"
    )
    assert not list(tmp_path.iterdir())
