"""The Python surface: its documentation page runs, and it writes what the command writes."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

import mobilecal_cli as mc
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.pipeline.calibrating import calibrate
from mobilecal_cli.solvers import constraints_of
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook")
    (folder / "sample_logs").symlink_to(REPOSITORY / "sample_logs")
    return folder


def test_the_page_runs_as_written(workplace, monkeypatch):
    monkeypatch.chdir(workplace)
    page = REPOSITORY / "docs" / "how-to" / "use-from-python.md"
    results = doctest.testfile(str(page), module_relative=False, encoding="utf-8")
    assert results.attempted > 10
    assert results.failed == 0


def test_the_command_writes_the_same_files(workplace, monkeypatch):
    """From the extraction of the page, which needs no images."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    extraction = workplace / "result" / "extraction.npz"
    calibrate([extraction], workplace / "by_command", gates=["point_rms_mm=12"], hold_out=0.3)
    data = mc.extract(str(extraction))
    report = mc.Report(data, mc.solve(data, hold_out=0.3), gates={"point_rms_mm": 12})
    report.save(Path(workplace / "by_hand"))
    for name in ("params.yaml", "report.json", "report.html", "extraction.npz"):
        one, other = (workplace / folder / name for folder in ("by_command", "by_hand"))
        assert one.read_bytes() == other.read_bytes(), name


def test_a_name_that_does_not_exist_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = mc.calibrat


def test_a_group_stands_for_its_kinds_of_constants():
    kinds = ("stereo_rotation", "baseline_direction", "baseline_length")
    assert constraints_of([], [], ["stereo"]).constants == kinds
    with pytest.raises(ConfigError, match="--estimate streo: no such") as caught:
        constraints_of([], [], ["streo"])
    assert caught.value.hint == "did you mean stereo?"


def test_an_unknown_format_is_refused():
    with pytest.raises(ConfigError, match="export to xarco: no such format"):
        mc.export_to("params.yaml", "xarco")
