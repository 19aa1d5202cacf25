"""evaluate and compare, gates and hold-out, with the command."""

import json
import shutil
import xml.etree.ElementTree as ET

import pytest

from mobilecal_cli.calibrate import steps
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.files.interruption import Interrupted
from mobilecal_cli.report.junit import junit_error_xml
from tests.command import run, succeeded

SAMPLE_STD = 0.02  # m; far above what the sample's separation has


@pytest.fixture(scope="module")
def made(sample_logs, tmp_path_factory):
    """A calibration of the sample log with a quarter of it held out, as CI would run it."""
    folder = tmp_path_factory.mktemp("made")
    done = succeeded(
        "calibrate", sample_logs / "paper_robot.mcap", "-o", folder / "out", "--hold-out", "0.25", "--json",
        "--gate", f"std.wheels.separation_m={SAMPLE_STD}", "--gate", "hold_out.translation_rms_mm=50",
        "--set", "gates.stations=9", "--junit", folder / "junit.xml",
    )  # fmt: skip
    return folder, done


@pytest.fixture(scope="module")
def result(made):
    """Its output directory."""
    return made[0] / "out"


def test_hold_out_gates_and_json(made):
    folder, done = made
    printed = json.loads(done.out)
    assert printed == json.loads((folder / "out" / "report.json").read_text(encoding="utf-8"))
    assert printed["quality"]["stations"] == 9
    assert printed["hold_out"]["stations"] == 3
    assert printed["provenance"]["config"]["hold_out"] == 0.25
    assert printed["hold_out"]["drift_after"]["mm_per_m"] < printed["hold_out"]["drift_before"]["mm_per_m"]
    names = [check["name"] for check in printed["verdict"]["checks"]]
    assert {"gate std.wheels.separation_m", "gate hold_out.translation_rms_mm", "gate stations"} <= set(names)
    assert "Held-out stations" in (folder / "out" / "report.html").read_text(encoding="utf-8")
    suite = ET.parse(folder / "junit.xml").getroot().find("testsuite")
    assert [case.get("name") for case in suite.findall("testcase")] == names
    assert suite.get("failures") == "0"


def test_evaluate_with_gates(result):
    npz, params = result / "extraction.npz", result / "params.yaml"
    assert json.loads(succeeded("evaluate", npz, params, "--json").out)["stations"] == 12
    kept = succeeded("evaluate", npz, params, "--gate", "drift_deg_per_turn=3")
    assert "pass        gate drift_deg_per_turn" in kept.out
    assert "PASS: The calibration agrees with this recording" in kept.out
    junit = result.with_name("evaluate.xml")
    broken = run("evaluate", npz, params, "--gate", "rotation_rms_deg=0.001", "--junit", junit)
    assert broken.code == 6
    assert "fail        gate rotation_rms_deg" in broken.out
    assert "GATE FAILED: rotation_rms_deg = " in broken.out
    assert broken.err == ""
    assert ET.parse(junit).getroot().get("failures") == "1"
    succeeded("evaluate", npz, params, "--junit", junit)
    assert ET.parse(junit).getroot().get("failures") == "0"
    junit.write_text("<testsuites/>", encoding="utf-8")
    assert run("evaluate", npz, params, "--junit", junit).code == 7
    assert junit.read_text(encoding="utf-8") == "<testsuites/>"


def joined(text):
    """Wrapped lines as one."""
    return " ".join(text.split())


def changed_params(source, target, key, factor):
    """A copy of a params.yaml with one of its numbers multiplied."""
    text = source.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith(f"  {key}:"))
    value = float(line.split()[1]) * factor
    target.write_text(text.replace(line, f"  {key}: {value:.9f}"), encoding="utf-8")
    return target


@pytest.mark.long
def test_evaluate_notes_a_recording_of_the_calibration(result, sample_logs):
    """Found by content: the recording has another name here than the calibration states."""
    copy = result.with_name("renamed.bag.mcap")
    shutil.copyfile(sample_logs / "paper_robot.mcap", copy)
    note = "This recording was used for this calibration: the errors below are not independent."
    found = succeeded("evaluate", copy, result / "params.yaml", "--json", "--quiet")
    data = json.loads(found.out)
    assert [path.rpartition("/")[2] for path in data["used_for_calibration"]] == [copy.name]
    assert data["notes"][0] == note
    other = run("evaluate", sample_logs / "straight.mcap", result / "params.yaml", "--json", "-q")
    data = json.loads(other.out)
    assert data["used_for_calibration"] == []
    assert note not in data["notes"]


def test_evaluate_gives_a_verdict_without_gates(result, tmp_path):
    params = changed_params(result / "params.yaml", tmp_path / "params.yaml", "radius_right_m", 1.02)
    found = run("evaluate", result / "extraction.npz", params, "--json")
    assert found.code == 6, found.err
    verdict = json.loads(found.out)["verdict"]
    assert verdict["level"] == "FAIL"
    assert f"FAIL: {verdict['reason']}" in joined(found.err)
    assert verdict["next_step"]
    assert verdict["next_step"] in joined(found.err)


def test_a_recording_that_cannot_check_everything_is_not_enough(result, sample_logs):
    found = run("evaluate", sample_logs / "straight.mcap", result / "params.yaml", "--quiet")
    assert found.code == 6
    assert "NOT ENOUGH: The wheel separation is unobservable in this recording." in joined(found.out)
    assert "Turn the base" in joined(found.out)


def test_evaluate_another_robot(result, tmp_path):
    params = tmp_path / "params.yaml"
    text = (result / "params.yaml").read_text(encoding="utf-8")
    params.write_text(text.replace("head_link", "neck_link"), encoding="utf-8")
    found = run("evaluate", result / "extraction.npz", params)
    assert found.code == 2
    assert (
        "give the calibration of this robot; if this is it, set head.head_frame to neck_link in rig"
        in found.err
    )
    for frame, cure in (
        ("stereo_right_optical", "cameras.reference to right"),
        ("lens", "the cameras of the"),
    ):
        params.write_text(text.replace("stereo_left_optical", frame), encoding="utf-8")
        assert f"if this is it, set {cure}" in run("evaluate", result / "extraction.npz", params).err
    missing = run("evaluate", result / "extraction.npz", tmp_path / "none.yaml")
    assert missing.code == 2
    assert "none.yaml: cannot be read" in missing.err


def test_the_junit_file_of_an_earlier_run_does_not_stay(tmp_path, monkeypatch):
    """A run that SIGTERM ended left it, with PASS."""
    junit = tmp_path / "junit.xml"

    def interrupted(*_, **__):
        assert not junit.exists()
        raise Interrupted(143)

    monkeypatch.setattr(steps, "calibrate", interrupted)
    junit.write_bytes(junit_error_xml("log.mcap", ConfigError("an earlier one")))
    assert run("calibrate", "log.mcap", "--junit", junit, cwd=tmp_path).code == 143
    assert not junit.exists()
    assert run("evaluate", "log.mcap", "--junit", junit, cwd=tmp_path).code == 2
    assert "the only path given" in junit.read_text(encoding="utf-8")
    assert run("evaluate", "log.mcap", f"--junit={junit}", "--gatee", "a=1", cwd=tmp_path).code == 2
    assert not junit.exists()
    junit.write_text("precious", encoding="utf-8")
    assert run("evaluate", "log.mcap", "--junit", junit, "--gatee", "a=1", cwd=tmp_path).code == 2
    assert junit.read_text(encoding="utf-8") == "precious"


def test_compare(result, tmp_path):
    first = result / "params.yaml"
    limits = ("--max-sigma", "0.1", "--max-ray-mm", "0.01", "--max-heading-deg", "0.01")
    same = succeeded("compare", first, first, *limits)
    assert "share a recording" in same.out
    moved = changed_params(first, tmp_path / "moved.yaml", "separation_m", 1.2)
    apart = run("compare", first, moved, "--max-sigma", "4", "--json")
    assert apart.code == 6
    assert "separation by" in apart.err
    found = json.loads(apart.out)["against_first"][0]
    assert found["sigmas"][8] > 4
    assert found["heading_deg_per_turn"] < -1


def test_a_history_is_drawn(result, tmp_path):
    files = []
    for number in range(3):
        files.append(tmp_path / f"{number}.yaml")
        shutil.copyfile(result / "params.yaml", files[-1])
    done = succeeded("compare", *files, "--plot", tmp_path / "drift.svg")
    assert "All 3 calibrations" in done.out
    ET.parse(tmp_path / "drift.svg")
    assert run("compare", *files, "--plot", tmp_path / "drift.svg").code == 7
    assert run("compare", files[0]).code == 2
