"""Gates: names, units and values of the figures that they limit, and what CI reads of them."""

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model.solution import Drift, Evaluation
from mobilecal_cli.report.criteria import Metric
from mobilecal_cli.report.evaluation import EvaluationData
from mobilecal_cli.report.formats import json_text, like
from mobilecal_cli.report.junit import junit_error_xml, junit_xml
from mobilecal_cli.report.numbers import PARAMETERS
from mobilecal_cli.report.use import FIGURES
from mobilecal_cli.report.verdict import (
    Verdict,
    evaluated_figures,
    figures_of,
    gate_checks,
    gate_metrics,
    gates_of,
)
from tests.conftest import REPOSITORY
from tests.judging import judge
from tests.report.example import case_of, made, make_solution

EVALUATION = Evaluation(
    stations=3,
    legs=np.array([[0, 0, 1], [0, 1, 2]]),
    reprojection_px=np.array([3.0, 4.0]),
    rotation_rad=np.radians([1.0, 1.0]),
    translation_m=np.array([0.006, 0.008]),
    driven_m=1.5,
    turned_rad=0.2,
    before=Drift(50.0, None),
    after=Drift(4.0, None),
)


def test_flags_lie_over_the_configuration():
    found = gates_of(["stations=10"], {"stations": 5, "point_rms_mm": 12})
    assert found == {"stations": 10, "point_rms_mm": 12}


@pytest.mark.parametrize(
    ("flags", "config", "says", "hint"),
    [
        (["reprojection_px=1"], {}, "--gate reprojection_px=1: unknown figure", "reprojection_rms_px"),
        ([], {"std.wheels.seperation_m": 1}, "gates.std.wheels.seperation_m", "std.wheels.separation_m"),
        (["stations"], {}, "not of the form NAME=LIMIT", "for example"),
        (["stations=many"], {}, "'many' is not a finite number", "for example"),
        (["stations=nan"], {}, "'nan' is not a finite number", "for example"),
        (["stations=9", "stations=10"], {}, "--gate stations=10: a second limit of stations", "one limit"),
        (["xyz=3"], {}, "--gate xyz=3: unknown figure", "docs/how-to/use-in-ci.md lists all figures"),
    ],
)
def test_bad_gates(flags, config, says, hint):
    with pytest.raises(ConfigError, match=says) as caught:
        gates_of(flags, config)
    assert hint in caught.value.hint


@pytest.mark.parametrize(("flags", "config"), [(["hold_out.legs=3"], {}), ([], {"hold_out.legs": 3})])
def test_gates_of_the_hold_out_test_need_one(flags, config):
    with pytest.raises(ConfigError, match="gate hold_out\\.legs: no stations are held out"):
        gates_of(flags, config, hold_out=False)
    assert gates_of(flags, config) == {"hold_out.legs": 3}


def test_gates_of_the_other_command_are_left_alone():
    """With one file for both commands: each calibration failed a gate of `evaluate`, whose figure it does not have."""
    both = {"point_rms_mm": 12, "legs": 5, "rotation_rms_deg": 1.0}
    assert gates_of([], both, evaluating=True) == {"legs": 5, "rotation_rms_deg": 1.0}
    assert gates_of([], both) == {"point_rms_mm": 12, "legs": 5}
    with pytest.raises(ConfigError, match="unknown figure"):
        gates_of(["point_rms_mm=12"], {}, evaluating=True)


def test_figures_of_an_evaluation():
    figures = evaluated_figures(EVALUATION)
    assert figures["reprojection_rms_px"] == pytest.approx(np.sqrt(12.5))
    assert figures["rotation_rms_deg"] == pytest.approx(1.0)
    assert figures["translation_rms_mm"] == pytest.approx(np.sqrt(50))
    assert figures["drift_mm_per_m"] == pytest.approx(4.0)
    assert figures["drift_deg_per_turn"] is None
    turned = evaluated_figures(replace(EVALUATION, after=Drift(None, 3.6)))
    assert turned["drift_deg_per_turn"] == pytest.approx(3.6)
    data = json.loads(json_text(like(EvaluationData, EVALUATION)))
    assert data["drift_before"] == {"mm_per_m": pytest.approx(50), "deg_per_turn": None}
    assert data["per_leg"][1]["translation_mm"] == pytest.approx(8)


def test_each_side_of_a_limit():
    names = ["stations", "legs", "translation_rms_mm", "drift_mm_per_m", "drift_deg_per_turn"]
    gates = dict(zip(names, (3, 3, 7, 4.0, 100), strict=True))
    checks = list(gate_checks(gates, evaluated_figures(EVALUATION)))
    assert [check.outcome for check in checks] == ["pass", "fail", "fail", "pass", "fail"]
    assert checks[1].why == "legs = 2 (at least 3)."
    assert "unknown (at most 100 deg)" in checks[4].why
    assert checks[4].next_step.startswith("Leave out this gate")
    assert checks[2].next_step == "Record again, or change the limit."


def test_the_default_method_gives_figures_that_others_do_not(extraction, report):
    kinds = ("std.", "predicted.", "noise.", "motion.")
    assert None not in [value for name, value in report.metrics.items() if name.startswith(kinds)]
    unknown = figures_of(case_of(make_solution(extraction, "lm"), extraction))
    assert unknown["std.wheels.separation_m"] is None
    assert unknown["hold_out.legs"] is None


@pytest.mark.parametrize(
    "gates",
    [
        ["point_rms_mm=0.1", "legs=50"],
        ["predicted.camera_mm=0.001", "predicted.point_mm=0.001", "legs=50"],
    ],
)
def test_the_reason_names_every_failed_gate(solution, extraction, gates):
    verdict = judge(solution, extraction, gates_of(gates, {}))
    assert verdict.reason.replace("Gate failed: ", "") == " ".join(verdict.reasons)
    assert ("Gate failed: legs = 11" in verdict.reason) == (verdict.level == "NOT ENOUGH")
    assert len(verdict.reasons) == len(gates)


def test_junit():
    def check(name, value, limit, text, next_step, **more):
        return Metric(text, at_least=name == "stations").check(value, limit, text, next_step, **more)

    checks = [
        check("stations", 9, 8, "stations", "not said"),
        check("camera_info", 1, 0, "camera_info", "look", at_limit="none", why="why\x1b", beyond="warning"),
        check("rejected", 60, 50, "rejected <&>\x00", "again", why="often <&>\x00"),
        check("gate.legs", 3, 4, "gate legs", "more", why="too few", passes=False, beyond="not_enough"),
    ]
    verdict = Verdict("FAIL", "", "", tuple(checks))
    suites = ET.fromstring(junit_xml("log\x07.mcap", verdict, 12.5))
    suite = suites.find("testsuite")
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("4", "2", "0")
    assert [each.get("time") for each in (suites, suite)] == ["12.500", "12.500"]
    cases = suite.findall("testcase")
    assert [case.get("name") for case in cases] == [
        "stations",
        "camera_info",
        "rejected <&>\\x00",
        "gate legs",
    ]
    failed, text = cases[2].find("failure"), [case.find("system-out").text for case in cases]
    assert (failed.get("message"), failed.get("type"), failed.text) == ("often <&>\\x00", "fail", "again")
    assert text[:2] == ["measured: 9; limit: at least 8", "measured: 1; limit: none; warning: why\\x1b"]
    assert [case.find("failure") is not None for case in cases] == [False, False, True, True]
    broken = ET.fromstring(junit_error_xml("log", RecordingError("no\x00thing", "look")))
    assert broken.find("testsuite/testcase/error").get("type") == "recording"


METRICS = gate_metrics() | gate_metrics(evaluating=True)
#: Unit → how many of it are one SI unit.
PER_SI = {
    "mm": 1e3,
    "m": 1.0,
    "rad": 1.0,
    "px": 1.0,
    "deg": math.degrees(1),
    "degrees": math.degrees(1),
    "mm/m": 1e3,
    "deg/m": math.degrees(1),
    "ms": 1e3,
    "%": 100.0,
    "rad per sqrt(rad)": 1.0,
    "": 1.0,
}


@pytest.fixture(scope="module")
def solution(extraction):
    return make_solution(extraction, "ml")


@pytest.fixture(scope="module")
def report(solution, extraction):
    return made(solution, extraction, trial=EVALUATION)


def test_a_name_that_ends_in_a_unit_has_it():
    units = sorted({unit for unit in PER_SI if unit}, key=len)
    for name, metric in METRICS.items():
        ends = [unit for unit in units if name.endswith("_" + unit.replace("/", "_per_"))]
        if name.endswith("_per_turn"):
            ends = ["deg"]
        if ends:
            assert metric.unit.replace("degrees", "deg") == ends[-1], name


def test_the_metrics_of_the_report_are_the_gates(report):
    assert set(report.metrics) == {name for name in gate_metrics() if not name.startswith("std.odometry.")}
    assert all(list(gates_of([f"{name}=1"], {})) == [name] for name in report.metrics)


def test_metrics_are_the_numbers_in_si_units_in_theirs(report, solution):
    uncertainty, wheels = solution.uncertainty, solution.parameters.wheels
    noise, std = uncertainty.noise, np.sqrt(np.diag(uncertainty.reference_covariance))
    for name, value in {
        **{figure.name: getattr(uncertainty.at_work, figure.field) for figure in FIGURES},
        **{parameter.gate: sigma for parameter, sigma in zip(PARAMETERS, std, strict=True)},
        "noise.joint": noise.joint_rad,
        "noise.wheel": noise.wheel_rad_per_sqrt_rad,
        "noise.wheel_share": noise.wheel_share,
        "noise.floor": noise.floor_rad,
        "noise.height": noise.floor_m,
        "noise.stamp": 0.0,  # of a robot that rests at every station
        "noise.sliding_joint": 0.0,
        "point_rms_mm": solution.point_rms_m,
        "reprojection_rms_px": solution.reprojection_rms_px,
        "leg_outlier.point": solution.residuals.leg_point_rms_m.max(),
        "stereo_error": noise.pixel_px,
        "motion.driven_m": solution.motion["driven_m"],
        "wheel_difference": abs(wheels.radius_right_m - wheels.radius_left_m) / min(wheels.vector[:2]),
        "stations": 12,
        "legs": 11,
        "observable": 9,
        "hold_out.rotation_rms_deg": np.sqrt(np.mean(EVALUATION.rotation_rad**2)),
        "hold_out.translation_rms_mm": np.sqrt(np.mean(EVALUATION.translation_m**2)),
        "hold_out.drift_mm_per_m": EVALUATION.after.mm_per_m / 1e3,
    }.items():
        assert report.metrics[name] == pytest.approx(value * PER_SI[METRICS[name].unit]), name
    for parameter in PARAMETERS:
        assert METRICS[parameter.gate].unit == parameter.unit
    for figure in (figure for figure in FIGURES if figure.limit is not None):
        assert report.verdict.check(figure.name).value == report.metrics[figure.name]


@pytest.mark.parametrize(
    ("value", "at_least", "outcome", "why"),
    [
        (1.0, False, "pass", ""),
        (-3.0, False, "fail", "Shift: -3 mm. Limit: at most 2 mm."),
        (math.nan, False, "fail", "Shift: nan mm. Limit: at most 2 mm."),
        (None, False, "fail", "Shift: unknown. Limit: at most 2 mm."),
        (-3.0, True, "not_enough", "Shift: -3 mm. Limit: at least 2 mm."),
        (2.0, True, "pass", ""),
    ],
)
def test_a_check_says_what_its_numbers_are(value, at_least, outcome, why):
    check = Metric("shift", "mm", at_least).check(value, 2.0, "shift", "Move it.")
    assert (check.outcome, check.why) == (outcome, why)
    assert check.next_step == ("" if outcome == "pass" else "Move it.")


@pytest.mark.parametrize(
    ("gate", "level"),
    [
        ("observable=9", "PASS"),
        ("legs=11", "PASS"),
        ("legs=12", "GATE FAILED"),
        ("noise.stamp=0.1", "PASS"),
        ("second_solution=2", "PASS"),
        ("second_solution=1e6", "GATE FAILED"),
        ("motion.driven_m=0.5", "PASS"),
        ("motion.driven_m=500", "GATE FAILED"),
        ("description=3", "PASS"),
        ("nominal.separation=5", "GATE FAILED"),  # without a nominal value
    ],
)
def test_a_gate_limits_any_figure(solution, extraction, gate, level):
    assert judge(solution, extraction, gates_of([gate], {})).level == level


def test_the_page_on_ci_names_every_gate():
    page = REPOSITORY / "docs" / "how-to" / "use-in-ci.md"
    text = page.read_text(encoding="utf-8")
    for name in (*gate_metrics(), *gate_metrics(evaluating=True)):
        if not name.startswith(("hold_out.", "std.head_eye.")):
            unit = METRICS[name].unit
            assert f"`{name}`" in text, f"add {name} to {page}"
            assert unit in ("", "rad", "m") or unit.replace("degrees", "deg") in text, (
                f"add its unit to {page}"
            )
