"""The measurements that agree, found from a first state that outliers spoil."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.measured import from_motions
from mobilecal_cli.solvers import Constraints
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.initial import start_state
from mobilecal_cli.solvers.robust import _stepped, _weight, agreeing
from tests.bench.simulated import spoiled
from tests.extractions import simulated
from tests.solvers.test_measured import T_V_C, legs
from tests.solvers.test_several_logs import NOISE, ROBOT, recorded


def started(extraction, constraints):
    """A point near the truth, with all measurements."""
    inference = Inference.of(extraction, constraints)
    everything = Inliers.all_of(inference.data)
    state = start_state(inference.data, inference.initial(), everything)
    noise = inference.first_noise(np.array([NOISE.pixel_px]))
    return Posterior.at(state, everything, noise, inference.priors(state))


def agreeing_of(extraction):
    _, inliers = agreeing([started(extraction, Constraints())], [])
    return inliers


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_third_of_bad_stations_and_a_slip(seed):
    ideal = simulated("standard", NOISE, ROBOT, 20, seed)
    extraction, bad, slip = spoiled(ideal, np.random.default_rng(seed), share=0.35)
    inliers = agreeing_of(extraction)
    assert np.flatnonzero(~inliers.views).tolist() == bad.tolist()
    # The slip is indistinguishable from one in the next leg where the station between them is bad.
    legs = np.flatnonzero(~inliers.legs)
    assert np.abs(legs - slip).min() <= 1
    # Tests with noise levels of their own decide on the few that the supposed ones reject beside it.
    assert len(legs) + np.sum(~inliers.readings) <= 3


def test_wrong_readings_are_told_from_wrong_images():
    extraction = recorded("standard", 1)
    seen = list(extraction.observations)
    for station, wrong_rad in ((2, 0.05), (7, -0.08)):
        joints = seen[station].joints.copy()
        joints[3] += wrong_rad
        seen[station] = replace(seen[station], joints=joints)
    inliers = agreeing_of(replace(extraction, observations=tuple(seen)))
    assert np.argwhere(~inliers.readings).tolist() == [[2, 3], [7, 3]]
    assert inliers.views.all()
    assert inliers.legs.all()


def test_weights_fall_from_one_to_zero_around_the_limit():
    """Over a width that shrinks: beyond it by more, a measurement has no weight."""
    beyond = np.array([0.0, 0.3, 0.9, 1.1, 2.9, 3.1])
    wide, narrow = _weight(beyond, 2.0, 1.0), _weight(beyond, 1e-3, 1.0)
    limit = np.median(beyond)
    assert np.all(np.diff(wide) <= 0)
    assert wide[0] == 1
    assert wide[4] > 0 == wide[5]
    assert np.array_equal(narrow, beyond <= max(limit, 1.0))


def test_legs_without_weight_that_are_recordings_of_their_own():
    """Nothing else holds the base at their ends: it stays where they say."""
    start = started(from_motions(legs(50, 1), (0.02, 0.02, 0.09), T_V_C), Constraints().of_planar_sensor())
    used = np.arange(50) % 3 != 0
    weights = {"views": np.ones(100), "legs": used.astype(float), "readings": np.ones((100, 0))}
    _, damping, gain = _stepped(start, weights, 0.0)
    assert damping == 0
    assert gain > 1
