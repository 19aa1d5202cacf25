"""The Python surface: its documentation page runs, and it writes what the command writes."""

import doctest
import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

import mobilecal_cli as mc
from mobilecal_cli.calibrate import steps
from mobilecal_cli.calibrate.steps import Data, calibrate
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.extraction import extraction_to_npz
from tests.command import run
from tests.conftest import REPOSITORY
from tests.report.example import make_extraction, make_solution, report_on


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    folder = tmp_path_factory.mktemp("notebook")
    (folder / "sample_logs").symlink_to(REPOSITORY / "sample_logs")
    return folder


@pytest.mark.long
def test_the_page_runs_as_written(workplace, monkeypatch):
    monkeypatch.chdir(workplace)
    page = REPOSITORY / "docs" / "how-to" / "use-from-python.md"
    results = doctest.testfile(str(page), module_relative=False, encoding="utf-8")
    assert results.attempted > 10
    assert results.failed == 0


def test_the_command_writes_the_same_files(tmp_path, monkeypatch):
    """From an extraction, which needs no images."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    extraction = tmp_path / "extraction.npz"
    extraction.write_bytes(extraction_to_npz(make_extraction()))
    calibrate([extraction], tmp_path / "by_command", gates=["point_rms_mm=12"], hold_out=0.3)
    data = mc.extract(str(extraction))
    report = mc.Report(data, mc.solve(data, hold_out=0.3), gates={"point_rms_mm": 12})
    report.save(tmp_path / "by_hand")
    for name in ("params.yaml", "report.json", "report.html", "extraction.npz"):
        one, other = (tmp_path / folder / name for folder in ("by_command", "by_hand"))
        assert one.read_bytes() == other.read_bytes(), name


@pytest.fixture(scope="module")
def data():
    return Data(make_extraction())


@pytest.fixture(scope="module")
def report(data):
    return report_on(make_solution(data.extraction, "ml"), data.extraction)


@pytest.mark.parametrize(
    "number", [np.float64(0.34), np.float32(0.34), np.array(0.34), Fraction(17, 50), Decimal("0.34")]
)
def test_numbers_of_any_kind(data, monkeypatch, number):
    monkeypatch.setattr(steps, "fitted", lambda _, method, constraints, *rest: constraints)
    prior = {"t_x": (number, np.float32(0.5)), "t_y": np.array([float(number), 0.01])}
    asked = mc.solve(data, fix={"separation": number, "t_z": np.int64(0)}, prior=prior)
    assert asked.fixed == {"separation": pytest.approx(0.34, abs=1e-7), "t_z": 0}
    assert asked.priors == {"t_x": (pytest.approx(0.34, abs=1e-7), 0.5), "t_y": (float(number), 0.01)}
    values = (*asked.fixed.values(), *asked.priors["t_x"], *asked.priors["t_y"])
    assert {type(value) for value in values} == {float}


def test_one_name_needs_no_list_and_numbers_may_be_numpys(data, monkeypatch, tmp_path):
    monkeypatch.setattr(steps, "fitted", lambda _, method, constraints, *rest: constraints)
    asked = mc.solve(data, fix="separation", estimate="pan_zero")
    assert (asked.fixed, asked.constants) == ({"separation": None}, ("pan_zero",))
    (tmp_path / "e.npz").write_bytes(extraction_to_npz(data.extraction))
    found = mc.extract(tmp_path / "e.npz", settings={"noise.pixel_px": np.float64(0.2)}, jobs=np.int64(1))
    assert found.extraction.rig.noise["pixel_px"] == 0.2


def test_values_are_shown_in_a_line(data, report):
    stations = "Extraction(12 stations, 1 recording: robot_0.mcap)"
    assert repr(data) == f"Data({stations})"
    assert repr(data.extraction) == stations
    for value in (report.fit, report.fit.solution, report):
        assert re.search(r"point error 11\.\d mm", repr(value))
        assert "\n" not in repr(value)
        assert len(repr(value)) < 150
    assert repr(report).startswith("Report(PASS, Fit('ml', ")


def test_a_report_is_printed_as_the_command_prints_it(data, report, tmp_path, capsys):
    print(report)
    lines = capsys.readouterr().out.splitlines()
    (tmp_path / "e.npz").write_bytes(extraction_to_npz(data.extraction))
    printed = run("calibrate", "e.npz", cwd=tmp_path).out.splitlines()
    assert lines == printed[:-1]  # without the names of the files
    assert lines[-1] == "Next: Use params.yaml on the robot."


def test_the_public_names_are_completed():
    assert set(mc.__all__) <= set(dir(mc))
    assert not {"Any", "TYPE_CHECKING", "import_module"} & set(dir(mc))
    assert mc.MobilecalError.__subclasses__()
    from rlcompleter import Completer

    completer = Completer({"mc": mc})
    assert {completer.complete("mc.sol", n) for n in range(2)} == {"mc.solve(", None}
    assert completer.complete("mc.ext", 0) == "mc.extract("


@pytest.mark.parametrize("target", ["xacro", "camchain", "odometry_covariance", "foxglove", "json"])
def test_a_report_is_exported_as_its_file(report, tmp_path, target):
    report.save(tmp_path / "result")
    from_file = mc.export_to(tmp_path / "result" / "params.yaml", target)
    assert mc.export_to(report, target).notes == from_file.notes
    assert mc.export_to(report, target).content == from_file.content


def test_what_cannot_be_exported_is_refused(report):
    with pytest.raises(ConfigError, match="--to urdf changes"):
        mc.export_to(report, "urdf")
    linear = mc.Report(report.data, mc.solve(report.data, method="linear"))
    with pytest.raises(ConfigError, match=r"^the report: the stereo pair was not estimated"):
        mc.export_to(linear, "camera_info_left")
    with pytest.raises(ConfigError, match="export to xarco: no such format"):
        mc.export_to("params.yaml", "xarco")
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = mc.calibrat
