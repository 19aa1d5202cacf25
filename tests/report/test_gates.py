"""Gates, and what CI reads of them."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model import Drift, Evaluation
from mobilecal_cli.report.criteria import Check, Checks
from mobilecal_cli.report.evaluation import evaluation_data, evaluation_text
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.junit import junit_error_xml, junit_xml
from mobilecal_cli.report.verdict import (
    Gate,
    Verdict,
    evaluated_figures,
    figures_of,
    gate_checks,
    gates_of,
    judge,
    verdict_data,
)
from mobilecal_cli.simulate.ideal import Noise, ideal_extraction
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import solve
from tests.report.example import make_extraction, make_solution

EVALUATION = Evaluation(
    stations=3,
    legs=np.array([[0, 0, 1], [0, 1, 2]]),
    reprojection_px=np.array([3.0, 4.0]),
    rotation_rad=np.radians([1.0, 1.0]),
    translation_m=np.array([0.006, 0.008]),
    driven_m=1.5,
    turned_rad=0.2,
    before=Drift(0.05, None),
    after=Drift(0.004, None),
)


def test_flags_lie_over_the_configuration():
    found = gates_of(["stations=10"], {"stations": 5, "point_rms_mm": 12})
    assert found == (Gate("stations", 10), Gate("point_rms_mm", 12))


@pytest.mark.parametrize(
    ("flags", "config", "says", "hint"),
    [
        (["reprojection_px=1"], {}, "--gate reprojection_px=1: unknown figure", "reprojection_rms_px"),
        ([], {"std.wheels.seperation_m": 1}, "gates.std.wheels.seperation_m", "std.wheels.separation_m"),
        (["stations"], {}, "not of the form NAME=LIMIT", "for example"),
        (["stations=many"], {}, "not of the form NAME=LIMIT", "for example"),
        (["stations=nan"], {}, "not of the form NAME=LIMIT", "for example"),
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
    assert gates_of(flags, config) == (Gate("hold_out.legs", 3),)


def test_an_evaluation_leaves_the_gates_of_calibrations_alone():
    assert gates_of([], {"point_rms_mm": 12, "legs": 5}, evaluating=True) == (Gate("legs", 5),)
    with pytest.raises(ConfigError, match="unknown figure"):
        gates_of(["point_rms_mm=12"], {}, evaluating=True)


def test_figures_of_an_evaluation():
    figures = evaluated_figures(EVALUATION)
    assert figures["reprojection_rms_px"] == pytest.approx(np.sqrt(12.5))
    assert figures["rotation_rms_deg"] == pytest.approx(1.0)
    assert figures["translation_rms_mm"] == pytest.approx(np.sqrt(50))
    assert figures["drift_mm_per_m"] == pytest.approx(4.0)
    assert figures["drift_deg_per_turn"] is None
    data = json.loads(json_text(evaluation_data(EVALUATION)))
    assert data["drift_before"] == {"mm_per_m": pytest.approx(50), "deg_per_turn": None}
    assert data["per_leg"][1]["translation_mm"] == pytest.approx(8)
    assert "worst" in evaluation_text(evaluation_data(EVALUATION))


def test_each_side_of_a_limit():
    names = ["stations", "legs", "translation_rms_mm", "drift_mm_per_m", "drift_deg_per_turn"]
    gates = [Gate(name, limit) for name, limit in zip(names, (3, 3, 7, 4.0, 100), strict=True)]
    checks = list(gate_checks(gates, evaluated_figures(EVALUATION)))
    assert [check.outcome for check in checks] == ["pass", "fail", "fail", "pass", "fail"]
    assert checks[1].why == "Gate failed: legs = 2 (limit 3)."
    assert "unknown (limit 100)" in checks[4].why


def test_a_broken_gate_fails_a_sound_calibration():
    extraction = make_extraction()
    solution = make_solution(extraction)
    assert judge(solution, extraction).level == "PASS"
    assert judge(solution, extraction, [Gate("stations", 12)]).level == "PASS"
    verdict = judge(solution, extraction, [Gate("point_rms_mm", 5)])
    assert verdict.level == "FAIL"
    assert "point_rms_mm" in verdict.reason


def test_gates_limit_the_values_of_criteria():
    extraction = make_extraction()
    solution = make_solution(extraction)
    value = judge(solution, extraction).checks["leg_outlier.point"].value
    for limit, level in ((value + 0.1, "PASS"), (value - 0.1, "FAIL")):
        verdict = judge(solution, extraction, gates_of([f"leg_outlier.point={limit}"], {}))
        assert verdict.level == level
        assert verdict.checks["gate.leg_outlier.point"].value == value


def test_figures_of_a_calibration_are_those_of_its_files():
    robot = ROBOTS["paper"]()
    extraction = ideal_extraction(robot, plan_route(robot), Noise(pixel_px=0.2, joint_rad=1e-3), seed=1)
    solution = solve(extraction)
    figures = figures_of(solution, extraction, EVALUATION)
    assert figures["std.wheels.separation_m"] == pytest.approx(solution.uncertainty.std[8])
    assert figures["std.head_eye.r_x_rad"] == pytest.approx(solution.uncertainty.std[0])
    assert figures["hold_out.drift_mm_per_m"] == pytest.approx(4.0)
    assert all(
        figures[name] is not None
        for name in figures
        if name.startswith(("std.", "predicted.", "noise.", "motion."))
    )
    unknown = figures_of(solve(extraction, "lm"), extraction)
    assert unknown["std.wheels.separation_m"] is None
    assert unknown["hold_out.legs"] is None


def test_a_failed_gate_shows_a_value_that_differs_from_its_limit():
    figures = {"stations": 1234.0, "point_rms_mm": 2.84886, "reprojection_rms_px": 0.5000012}
    gates = [Gate(name, limit) for name, limit in zip(figures, (2000, 0.5, 0.5), strict=True)]
    assert [check.why for check in gate_checks(gates, figures)] == [
        "Gate failed: stations = 1234 (limit 2000).",
        "Gate failed: point_rms_mm = 2.85 (limit 0.5).",
        "Gate failed: reprojection_rms_px = 0.500001 (limit 0.5).",
    ]


def test_junit():
    checks = [
        Check("stations", 9, 8, "pass", "stations", "9", "at least 8", "not said"),
        Check("camera_info", 1, 0, "warning", "camera_info", "1 changes", "none", "why\x1b", "look"),
        Check(
            "rejected", 60, 50, "fail", "rejected <&>\x00", "6 of 10", "under 50 %", "often <&>\x00", "again"
        ),
        Check("gate.legs", 3, 4, "not_enough", "gate legs", "3", "at least 4", "too few", "more"),
    ]
    verdict = verdict_data(Verdict("FAIL", "", "", Checks(checks)))
    suite = ET.fromstring(junit_xml("log\x07.mcap", verdict)).find("testsuite")
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("4", "2", "0")
    cases = suite.findall("testcase")
    assert [case.get("name") for case in cases] == [
        "stations",
        "camera_info",
        "rejected <&>\\x00",
        "gate legs",
    ]
    failed, text = cases[2].find("failure"), [case.find("system-out").text for case in cases]
    assert (failed.get("message"), failed.get("type"), failed.text) == ("often <&>\\x00", "fail", "again")
    assert text[:2] == [
        "measured: 9; limit: at least 8",
        "measured: 1 changes; limit: none; warning: why\\x1b",
    ]
    assert [case.find("failure") is not None for case in cases] == [False, False, True, True]
    broken = ET.fromstring(junit_error_xml("log", RecordingError("no\x00thing", "look")))
    assert broken.find("testsuite/testcase/error").get("type") == "recording"
