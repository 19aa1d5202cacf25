"""Every line of docs/validation/refusals.md, on the whole command."""

import pytest

from tests.command import run
from tests.conftest import REPOSITORY
from tests.hostile.refusals import CASES, table


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_command_says_what_is_wrong(case, tmp_path):
    case.make(tmp_path)
    before = sorted(tmp_path.iterdir())
    result = run(*case.arguments, cwd=tmp_path, environment=case.environment)
    assert result.code == case.code, result.err
    assert "Traceback" not in result.err
    assert "Warning" not in result.err
    if case.code == 0:
        assert case.says in result.out
        return
    assert result.err.startswith("error: ")
    assert case.says in result.err.splitlines()[0]
    assert "\nhint: " in result.err
    assert len(result.err) < 4000
    assert sorted(tmp_path.iterdir()) == before


def test_the_table_is_up_to_date():
    assert (REPOSITORY / "docs/validation/refusals.md").read_text(encoding="utf-8") == table()
