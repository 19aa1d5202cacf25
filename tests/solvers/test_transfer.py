"""Eq. 19: its exact minimum, and two minimisers that must agree."""

import numpy as np
import pytest

from mobilecal_cli.solvers.initial import linear_estimate
from mobilecal_cli.solvers.transfer import by_parameters, point_rms_m, refine_lm, refine_powell, residuals_m
from tests.solvers.test_linear import ROBOT, largest_error, pairs_of
from tests.truth import errors, parameters_of

TRUTH = parameters_of(ROBOT)


def test_the_truth_carries_every_point_onto_itself():
    assert np.abs(residuals_m(pairs_of(0), TRUTH)).max() < 1e-12


def test_the_derivatives_are_those_of_differences():
    pairs, start = pairs_of(1), TRUTH.plus(np.full(9, 0.03))
    steps = 1e-5 * np.eye(9)
    after = np.array([residuals_m(pairs, start.plus(step)).ravel() for step in (*steps, *-steps)])
    assert by_parameters(pairs, start) == pytest.approx((after[:9] - after[9:]).T / 2e-5, rel=1e-6, abs=1e-6)


def test_error_in_mm_by_hand():
    # Wheels as they are, but the camera 10 mm further along its own x axis than the truth.
    pairs = pairs_of(0, "base_fixed")
    along_x = np.concatenate([np.zeros(3), TRUTH.T_h_c[:3, 0] * 0.01, np.zeros(3)])
    shifted = TRUTH.plus(along_x)
    # p^ - p = (R_ci_cj - I) d for the shift d: only turned legs show it.
    i, j = pairs.legs.T
    R = (pairs.T_c_k[i] @ np.linalg.inv(pairs.T_c_k[j]))[:, :3, :3]
    by_hand = np.sqrt(np.mean(np.sum(((R - np.eye(3)) @ [0.01, 0, 0]) ** 2, axis=1)))
    assert point_rms_m(pairs, shifted) == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize("refine", [refine_lm, refine_powell])
def test_exact_data(refine):
    pairs = pairs_of(1)
    refined = refine(pairs, linear_estimate(pairs).parameters)
    assert largest_error(refined) < 1e-9


def test_lm_finds_the_truth_from_far_off():
    pairs = pairs_of(1)
    start = TRUTH.plus(np.array([0.2, -0.15, 0.2, 0.05, -0.05, 0.05, 0.03, -0.02, 0.08]))
    refined = refine_lm(pairs, start)
    assert largest_error(refined) < 1e-9
    assert np.all(np.diff(refined.point_rms_history_m) <= 0)
    assert refined.point_rms_history_m[0] == pytest.approx(point_rms_m(pairs, start))


def test_powell_and_lm_reach_the_same_minimum():
    pairs = pairs_of(0, pixel_px=0.3)
    start = linear_estimate(pairs)
    lm, powell = refine_lm(pairs, start.parameters), refine_powell(pairs, start.parameters)
    assert powell.point_rms_m == pytest.approx(lm.point_rms_m, rel=1e-9)
    assert errors(powell.parameters, ROBOT) == pytest.approx(errors(lm.parameters, ROBOT), abs=1e-5)
    assert lm.point_rms_m <= start.point_rms_m
    assert lm.point_rms_history_m[-1] == lm.point_rms_m
    assert powell.point_rms_history_m[-1] == powell.point_rms_m
    assert powell.evaluations > lm.evaluations
