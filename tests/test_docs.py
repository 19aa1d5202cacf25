"""What is made out of the code is what is in docs/."""

from __future__ import annotations

import importlib.util

import pytest

from mobilecal_cli import errors
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def generator():
    path = REPOSITORY / "docs" / "generate" / "errors.py"
    spec = importlib.util.spec_from_file_location("generate_errors", path)
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_error_catalogue_is_up_to_date(generator):
    assert generator.TARGET.read_text(encoding="utf-8") == generator.catalogue(), "run: make docs"


def test_every_kind_of_error_has_its_own_code_and_exit_code(generator):
    kinds = generator.KINDS.values()
    assert len({kind.code for kind in kinds}) == len({kind.exit_code for kind in kinds}) == 6
    assert {kind.exit_code for kind in kinds} == {2, 3, 4, 5, 6, 7}
    assert issubclass(errors.QualityError, errors.MobilecalError)


def test_every_error_says_what_to_do(generator):
    """But for the readers' findings on one picture, which become rejections with their own cure."""
    lines = [line.split(" | ") for line in generator.catalogue().splitlines() if line.startswith("| ")]
    without = {room.removeprefix("| ") for room, _, cure in lines if cure in ("|", " |")}
    assert without == {"readers/images", "readers/video"}
