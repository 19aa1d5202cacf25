"""Every line of docs/reference/refusals.md, on the whole command."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY
from tests.hostile.refusals import CASES, table

EXISTING = ("out: already exists",)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_command_says_what_is_wrong(case, tmp_path):
    case.make(tmp_path)
    before = sorted(tmp_path.iterdir())
    result = subprocess.run(
        [sys.executable, "-m", "mobilecal_cli", *map(str, case.arguments)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **case.environment},
    )
    assert result.returncode == case.code, result.stderr
    assert "Traceback" not in result.stderr
    assert "Warning" not in result.stderr
    if case.code == 0:
        assert case.says in result.stdout
        return
    assert result.stderr.startswith("error: ")
    assert case.says in result.stderr.splitlines()[0]
    assert "\nhint: " in result.stderr
    assert len(result.stderr) < 4000
    assert sorted(tmp_path.iterdir()) == before


def test_the_table_is_up_to_date():
    assert (REPOSITORY / "docs/reference/refusals.md").read_text(encoding="utf-8") == table()
