"""Names, units and gates of the figures: one table, whose values are the SI values of the results."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mobilecal_cli.report.criteria import Calibration, Check, Criterion, Metric
from mobilecal_cli.report.numbers import PARAMETERS
from mobilecal_cli.report.use import FIGURES
from mobilecal_cli.report.verdict import (
    Gate,
    evaluated_figures,
    figures_of,
    gate_checks,
    gate_metrics,
    gate_names,
    gates_of,
    judge,
)
from mobilecal_cli.solvers import solve
from tests.conftest import REPOSITORY
from tests.report.example import made, make_extraction
from tests.report.test_gates import EVALUATION

METRICS = gate_metrics() | gate_metrics(evaluating=True)
#: End of a name → unit of the value.
UNITS = {
    "_mm": "mm",
    "_m": "m",
    "_rad": "rad",
    "_deg": "deg",
    "_px": "px",
    "_mm_per_m": "mm/m",
    "_deg_per_m": "deg/m",
    "_deg_per_turn": "deg",
}
#: How many of a unit are one SI unit.
PER_SI = {
    "mm": 1e3,
    "m": 1.0,
    "rad": 1.0,
    "deg": math.degrees(1),
    "mm/m": 1e3,
    "deg/m": math.degrees(1),
    "ms": 1e3,
}
PER_SI |= {"degrees": math.degrees(1), "%": 100.0, "rad per sqrt(rad)": 1.0}


@pytest.fixture(scope="module")
def extraction():
    return make_extraction()


@pytest.fixture(scope="module")
def solution(extraction):
    return solve(extraction)


@pytest.fixture(scope="module")
def report(solution, extraction):
    return made(solution, extraction, trial=EVALUATION)


def test_a_name_that_ends_in_a_unit_has_it():
    for name, metric in METRICS.items():
        ends = [end for end in UNITS if name.endswith(end)]
        if ends:
            assert metric.unit.replace("degrees", "deg") == UNITS[max(ends, key=len)], name


def test_the_metrics_of_the_report_are_the_gates(report):
    assert set(report.metrics) == set(gate_names())
    assert all(gates_of([f"{name}=1"], {})[0].name == name for name in report.metrics)


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.name)
def test_expected_errors_are_those_in_si_units(report, figure):
    value = getattr(report.uncertainty.predicted, figure.field)
    assert report.metrics[figure.name] == pytest.approx(value * PER_SI[figure.unit])
    if figure.limit is not None:
        check = next(check for check in report.verdict.checks if check.id == figure.name)
        assert (check.value, check.unit) == (report.metrics[figure.name], figure.unit)


def test_standard_deviations_are_those_in_si_units(report, solution):
    std = np.sqrt(np.diag(solution.uncertainty.reference_covariance))
    for parameter, sigma in zip(PARAMETERS, std, strict=True):
        assert report.metrics[parameter.gate] == pytest.approx(sigma)
        assert METRICS[parameter.gate].unit == parameter.unit


def test_noise_levels_are_those_in_si_units(report, solution):
    noise = solution.uncertainty.noise
    for name, value in {
        "noise.joint": noise.joint_rad,
        "noise.wheel": noise.wheel_rad_per_sqrt_rad,
        "noise.wheel_share": noise.wheel_share,
        "noise.floor": noise.floor_rad,
        "noise.height": noise.floor_m,
        "noise.stamp": 0.0,  # of a robot that rests at every station
        "noise.sliding_joint": 0.0,
    }.items():
        assert report.metrics[name] == pytest.approx(value * PER_SI[METRICS[name].unit]), name


def test_errors_are_those_in_si_units(report, solution, extraction):
    found = report.metrics
    assert found["point_rms_mm"] == pytest.approx(1e3 * solution.point_rms_m)
    assert found["reprojection_rms_px"] == solution.reprojection_rms_px
    assert found["leg_outlier.point"] == pytest.approx(1e3 * solution.residuals.leg_point_rms_m.max())
    assert found["stereo_error"] == solution.uncertainty.noise.pixel_px
    assert found["motion.driven_m"] == solution.motion["driven_m"]
    wheels = solution.parameters.wheels
    apart = abs(wheels.radius_right_m - wheels.radius_left_m) / min(wheels.vector[:2])
    assert found["wheel_difference"] == pytest.approx(100 * apart)
    assert (found["stations"], found["legs"], found["observable"]) == (12, 11, 9)
    held_out = {name: found[f"hold_out.{name}"] for name in evaluated_figures(EVALUATION)}
    assert held_out["rotation_rms_deg"] == pytest.approx(
        math.degrees(np.sqrt(np.mean(EVALUATION.rotation_rad**2)))
    )
    assert held_out["translation_rms_mm"] == pytest.approx(
        1e3 * np.sqrt(np.mean(EVALUATION.translation_m**2))
    )
    assert held_out["drift_mm_per_m"] == pytest.approx(1e3 * EVALUATION.after.m_per_m)


def test_every_criterion_has_the_unit_of_the_table(report):
    assert all(
        (check.unit, check.at_least) == (METRICS[check.id].unit, METRICS[check.id].at_least)
        for check in report.verdict.checks
    )
    (check,) = gate_checks([Gate("hold_out.legs", 3.0)], report.metrics)
    assert check.at_least


def test_an_id_has_the_unit_of_its_kind(solution, extraction):
    made = Calibration(solution, extraction)
    checks = [Check(name, 1.0, 2.0, "fail", "", "", "") for name in ("kind.joint_zero.pan", "kind.b")]
    both = Criterion((Metric("kind", "sigma"), Metric("kind.b", "px")), False, lambda _: iter(checks))
    assert [check.unit for check in both.checks(made)] == ["sigma", "px"]
    with pytest.raises(KeyError):
        next(Criterion((Metric("other"),), False, lambda _: iter(checks)).checks(made))


@pytest.mark.parametrize(
    ("gate", "level"),
    [
        ("observable=9", "PASS"),
        ("legs=11", "PASS"),
        ("legs=12", "FAIL"),
        ("noise.stamp=0.1", "PASS"),
        ("second_solution=2", "PASS"),
        ("second_solution=1e6", "FAIL"),
        ("motion.driven_m=0.5", "PASS"),
        ("motion.driven_m=500", "FAIL"),
        ("description=3", "PASS"),
        ("nominal.separation=5", "FAIL"),  # without a nominal value
    ],
)
def test_a_gate_limits_any_figure(solution, extraction, gate, level):
    assert judge(solution, extraction, gates_of([gate], {})).level == level


def test_a_gate_limits_the_size_of_a_signed_figure():
    (check,) = gate_checks([Gate("nominal.separation", 5.0)], {"nominal.separation": -30.0})
    assert check.outcome == "fail"


def test_without_standard_deviations_they_are_unknown(extraction):
    figures = figures_of(solve(extraction, "linear"), extraction)
    unknown = {name for name, value in figures.items() if value is None}
    assert {"noise.joint", "observable", "predicted.camera_mm", "std.wheels.separation_m"} <= unknown
    assert figures["motion.driven_m"] > 0


def test_the_page_on_ci_names_every_gate():
    page = (REPOSITORY / "docs" / "how-to" / "use-in-ci.md").read_text(encoding="utf-8")
    for name in (*gate_names(), *gate_names(evaluating=True)):
        if not name.startswith(("hold_out.", "std.head_eye.")):
            unit = METRICS[name].unit
            assert f"`{name}`" in page, name
            assert unit in ("", "rad", "m") or unit.replace("degrees", "deg") in page, name
