"""Contradictions, outliers and the jackknife."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import Evidence, EvidenceValue
from mobilecal_cli.model.solution import Outlier
from mobilecal_cli.report.findings import contradiction_sentences, outlier_sentences
from mobilecal_cli.report.text import summary_text
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.constraints import Constraints, constraints_of
from mobilecal_cli.solvers.fit import uncertainty_of
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.initial import start_state
from tests.extractions import simulated
from tests.judging import judge
from tests.report.example import (
    drawn,
    made,
    make_extraction,
    make_solution,
    solved,
    with_uncertainty,
)


def test_a_turned_camera_is_named_with_its_cure():
    solution, extraction = solved(("stereo_r_x", np.radians(1.0)))
    (found,) = solution.contradictions
    what, cure = contradiction_sentences(found, solution, extraction)
    assert what.startswith("Right camera: rotation about the left camera's x differs by +")
    assert what.endswith("deg from camera_info (prior 0.050 deg).")
    assert cure == "Recalibrate the stereo pair, or use the exported camera_info."
    free = found.values["stereo_r_x"]
    assert abs(free.value - np.radians(1.0)) < 4 * free.std
    assert what in " ".join(summary_text(made(solution, extraction), verbose=True).split())
    (table,) = (table for table in made(solution, extraction).tables if table.title == "Estimated constants")
    name, _, _, _, _, _, tag = table.rows[0]
    assert (name, tag) == ("stereo_r_x", "contradicts")


@pytest.mark.parametrize(("shift", "level"), [(1.9, "PASS"), (2.1, "FAIL")])
def test_a_contradiction_fails_where_the_result_depends_on_it(shift, level):
    solution, extraction = solved(("stereo_r_x", np.radians(1.0)))
    found = replace(solution.contradictions[0], shift_sigmas=shift)
    verdict = judge(replace(solution, contradictions=(found,)), extraction)
    assert verdict.level == level
    assert "Right camera" in verdict.reason + verdict.next_step


def test_a_rolling_shutter_that_nobody_states_is_no_fault():
    solution, extraction = solved(("stereo_r_x", np.radians(1.0)))
    (found,) = solution.contradictions
    values = {"readout": EvidenceValue(0.03, 0.0002, 0.0005)}
    shutter = Evidence("readout", "all cameras", values, 3600.0, 60.0, 2.3)
    verdict = judge(replace(solution, contradictions=(shutter,)), extraction)
    assert verdict.level == "PASS"
    assert "+30.00 ± 0.20 ms from a global shutter" in verdict.next_step
    verdict = judge(replace(solution, contradictions=(shutter, found)), extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("All cameras: readout differs")


def test_the_strongest_contradiction_is_named_if_any_fails():
    solution, extraction = solved(("stereo_r_x", np.radians(1.0)))
    (found,) = solution.contradictions
    strongest, other = (
        replace(found, shift_sigmas=1.0),
        replace(found, kind="joint_zero", part="pan", sigmas=5.0),
    )
    verdict = judge(
        replace(solution, contradictions=(strongest, replace(other, shift_sigmas=3.0))), extraction
    )
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("Right camera")
    verdict = judge(
        replace(solution, contradictions=(strongest, replace(other, shift_sigmas=1.0))), extraction
    )
    assert verdict.level == "PASS"


def test_squares_and_baseline_disagree_together():
    solution, extraction = solved(("square_scale", 0.02))
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("The stated squares and the stereo baseline disagree by ")
    assert "The recording cannot tell which of the two is wrong." in verdict.next_step
    (measured,) = set(re.findall(r"the squares measure ([\d.]+) mm \(stated: 80.00 mm\)", verdict.reason))
    assert float(measured) == pytest.approx(81.6, abs=0.4)
    assert solution.scale.ratio == pytest.approx(1.02, abs=0.005)


def test_no_stated_size_is_named_where_none_is_stated():
    solution, extraction = solved(("square_scale", 0.02))
    found = next(one for one in solution.contradictions if one.kind == "square_size")
    unstated = replace(extraction, board=replace(extraction.board, square_m=None))
    what, cure = contradiction_sentences(found, replace(solution, scale=None), unstated)
    assert what.startswith("Board: length of the baseline and size of the squares together differ ")
    assert "from the size that the stereo pair measures at each station (prior " in what
    assert cure == "Check that camera_info belongs to these images, and state board.square_m in rig.yaml."


def test_constants_that_the_recording_shows_only_together_are_named():
    solution, extraction = solved(("stereo_r_x", np.radians(1.0)))
    (found,) = solution.contradictions
    together = replace(found, values={name: replace(each, std=None) for name, each in found.values.items()})
    what, _ = contradiction_sentences(together, solution, extraction)
    assert what.startswith("Right camera: rotation about the left camera's x and rotation about")
    assert what.endswith(" together differ from camera_info (prior 0.050 deg).")


def test_the_jackknife_widens_sigmas_that_are_too_small():
    right, extraction = drawn()
    assert (right.uncertainty.widened == 1).all()
    given = {
        "pixel_px": 0.02,
        "joint_rad": 1e-4,
        "wheel_rad_per_sqrt_rad": 5e-4,
        "wheel_share": 1e-4,
        "floor_rad": np.radians(0.01),
        "floor_m": 1e-4,
        "sway_rad": 1e-6,
        "sway_m": 1e-6,
    }
    inference = Inference.of(replace(extraction, rig=replace(extraction.rig, noise=given)), Constraints())
    everything = Inliers.all_of(inference.data)
    state = start_state(inference.data, right.parameters, everything)
    fit = inference.fit(state, everything, inference.first_noise(np.array([given["pixel_px"]])))
    uncertainty = uncertainty_of(fit)
    as_noise = uncertainty.std / uncertainty.widened
    ratio, usual = uncertainty.jackknife_std / as_noise, 1 + 3.6 / np.sqrt(len(fit.data.legs))
    wide = ratio > 1.25 * usual
    assert wide.any()
    np.testing.assert_allclose(uncertainty.std[wide], uncertainty.jackknife_std[wide])
    assert (uncertainty.std <= np.maximum(uncertainty.jackknife_std, as_noise) * (1 + 1e-9)).all()


EXTRACTION = simulated(stations=8)


def moved(*stations):
    return [Outlier("station", 0, (i,), i, f"Station {i} is off.") for i in stations]


def test_a_few_are_listed_singly():
    slip = Outlier("slip", 0, (2, 3), 3, "Slip.")
    assert list(outlier_sentences([slip, *moved(1, 5)], EXTRACTION)) == [
        "Station 1 is off.",
        "Station 5 is off.",
        "Slip.",
    ]


@pytest.mark.parametrize(
    ("outliers", "said"),
    [
        (
            moved(1, 2, 5, 7),
            "4 stations whose images do not fit the others (1, 2, 5, 7). The first: Station 1 is off.",
        ),
        (
            [Outlier("slip", 0, (i, i + 1), i, "Slip.") for i in range(4)],
            "4 legs whose wheels do not fit the cameras: wheel slip or a moved board (0-1, 1-2, 2-3, 3-4). "
            "The first: Slip.",
        ),
    ],
)
def test_many_are_grouped_with_their_count_and_places(outliers, said):
    assert list(outlier_sentences(outliers, EXTRACTION)) == [said]


def test_noise_is_named_by_its_kind():
    solution = make_solution(make_extraction(), "ml")

    def said(*kinds):
        check = judge(replace(solution, noisy=kinds), make_extraction()).check("outliers_as_noise")
        assert (check.value, check.limit, check.outcome) == (len(kinds), 0, "warning")
        return check.why

    assert "joint readings differ" in said("readings")
    assert "legs' wheel rotations and of the joint readings" in said("legs", "readings")


def test_values_of_the_user_that_the_data_contradict_are_named():
    """Both 10 sigma from what the data show: a fixed value, and a prior as narrow as these."""
    right, extraction = drawn()
    x_std, separation_std = right.uncertainty.std[[NINE.index("t_x"), NINE.index("separation")]]
    x = right.parameters.T_h_c[0, 3] + 10 * x_std
    separation = right.parameters.wheels.separation_m + 10 * separation_std
    constraints = constraints_of([f"separation={separation:.6f}"], [f"t_x={x:.6f}+-{x_std:.6f}"], [])
    solution = solve(extraction, constraints=constraints)
    asked = solution.uncertainty.asked
    assert asked["--fix separation",] == pytest.approx((10.0, 10.0), rel=0.1)
    sigmas, shift = asked["--prior t_x",]
    assert sigmas == pytest.approx(10.0 / np.sqrt(2), rel=0.1)
    assert shift == pytest.approx(10.0, rel=0.1)
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    for given in ("--fix separation", "--prior t_x"):
        check = verdict.check(f"prior.{given.partition(' ')[2]}")
        assert check.outcome == "fail"
        assert check.why.startswith(f"The value of {given} is ")
        assert check.next_step == f"Correct {given} (m, rad, s; scales are relative), or leave it out."


def test_values_that_the_data_contradict_together_are_named_together():
    """Radii that correlate by more than 0.5, each 2.5 sigma from what the data show, to opposite sides."""
    right, extraction = drawn()
    radii, std = right.parameters.vector[6:8], right.uncertainty.std[6:8]
    values = radii + 2.5 * std * [1, -1]
    priors = [
        f"{name}={value:.7f}+-{sigma / 20:.7f}"
        for name, value, sigma in zip(NINE[6:8], values, std, strict=True)
    ]
    verdict = judge(solve(extraction, constraints=constraints_of([], priors, [])), extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith(
        "The values of --prior radius_right and --prior radius_left are together"
    )


def test_a_constant_that_the_user_fixes_is_tested():
    """An axis of the URDF was blamed, beside a PASS with a rotation that was off by 19 sigma."""
    _, extraction = drawn()
    name = "pan_zero"
    verdict = judge(solve(extraction, constraints=constraints_of([f"{name}=0.02"], [], [])), extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith(f"The value of --fix {name} is ")
    exact = replace(extraction, rig=replace(extraction.rig, prior_sigmas={name: 0.0}))
    shifted = [replace(o, joints=o.joints + np.array([0.02, 0.0])) for o in extraction.observations]
    wrong = replace(exact, observations=tuple(shifted))
    assert judge(solve(wrong), wrong).reason.startswith(f"The value of priors.{name} is ")
    right = judge(solve(exact), exact)
    assert right.level == "PASS"
    assert not [check for check in right.checks if check.id.startswith("prior.")]
    # Exact without it, and patterns of which there are more or fewer without it: nothing to compare.
    every = replace(extraction, rig=replace(extraction.rig, prior_sigmas={"all": 0.0, "board_corners": 1e-5}))
    asked = solve(every, constraints=constraints_of([f"{name}=0.01"], [], [])).uncertainty.asked
    assert set(asked) <= {("priors.board_corners",)}


@pytest.mark.parametrize(
    ("asked", "outcome"), [((3.9, 3.9), None), ((4.1, 1.9), "warning"), ((4.1, 2.1), "fail")]
)
def test_a_value_of_the_user_fails_where_it_moves_the_result(asked, outcome):
    solution, extraction = drawn()
    checks = judge(with_uncertainty(solution, asked={("--fix t_x",): asked}), extraction).checks
    outcomes = [check.outcome for check in checks if check.id == "prior.t_x"]
    assert outcomes == [outcome] * (outcome is not None)


def test_a_fixed_value_with_which_no_fit_ends_is_named(monkeypatch):
    def endless(*_):
        raise SolveError("did not converge", "check the head chain")

    _, extraction = drawn()
    monkeypatch.setattr(sys.modules["mobilecal_cli.solvers.solve"], "robust_fit", endless)
    with pytest.raises(SolveError) as raised:
        solve(extraction, constraints=constraints_of(["t_x=0.1"], [], []))
    assert raised.value.hint.startswith("leave out or correct --fix t_x; or ")
    tight = replace(
        extraction, rig=replace(extraction.rig, prior_sigmas={"all": 1e-6}, noise={"pixel_px": 1e-3})
    )
    with pytest.raises(SolveError) as raised:
        solve(tight)
    assert raised.value.hint.startswith("leave out or correct priors in rig.yaml, noise in rig.yaml; or ")


@pytest.mark.long
def test_a_fixed_value_with_which_little_fits_comes_first():
    """With most stations left out, the others do not show all: "NOT ENOUGH", with the advice to drive more turns."""
    _, extraction = drawn()
    verdict = judge(solve(extraction, constraints=constraints_of(["t_x=1.0"], [], [])), extraction)
    assert verdict.level == "FAIL"
    assert not verdict.check("observable").met
    assert re.match(r"The value of --fix t_x is \d+\.\d sigma from what the data show", verdict.reason)


def test_a_joint_of_negative_scale_has_the_wrong_sign():
    """Of a lift that was read upside down, the scale was "off by -199.7 %"."""
    solution, extraction = drawn()
    values = {"tilt_scale": EvidenceValue(-1.997, 0.005, 0.001)}
    found = Evidence("joint_scale", "tilt", values, chi2=1e4, sigmas=90.0, shift_sigmas=1.0)
    _, cure = contradiction_sentences(found, solution, extraction)
    assert cure.startswith("The readings of this joint have the wrong sign: reverse them")


def test_a_constant_is_compared_with_the_prior_of_the_user():
    _, extraction = drawn()
    solution = solve(extraction, constraints=constraints_of([], ["pan_zero=0.17+-0.03"], []))
    (found,) = solution.contradictions
    what, cure = contradiction_sentences(found, solution, extraction)
    assert "from --prior pan_zero (prior 1.7 deg)" in what
    assert cure == "Correct --prior pan_zero, or leave it out."
