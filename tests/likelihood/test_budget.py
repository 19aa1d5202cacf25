"""What stations say of shared parameters although it is not so: of the size of the world, and of levers."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.budget import _lengths, expected_gradient
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.initial import start_state
from mobilecal_cli.solvers.optimize import optimize
from tests.bench import imperfect
from tests.truth import parameters_of

SIGMA = 0.01


def test_stations_do_not_pull_the_size_of_the_squares():
    """Nothing but its prior tells it: 60 stations made it smaller by half a sigma, 2,000 by all that was possible."""
    level = replace(imperfect.USUAL, floor_rad=1e-5)  # the lever of a base that leans tells something of it
    case = imperfect.Case(robot="camera on the base", stations=60, noise=level)
    extraction = case.extraction(2)
    sigmas = {"all": 0.0, "square_scale": SIGMA}
    square = solve(replace(extraction, rig=replace(extraction.rig, prior_sigmas=sigmas))).constants[
        "square_scale"
    ]
    assert square.std == pytest.approx(SIGMA, rel=0.02)
    assert abs(square.value) < 0.1 * SIGMA


def half_log_determinant(lin):
    """Of the information of all unknowns but the shared parameters."""
    inverses = lin.normal.own_covariance, lin.normal.stations.inverse, lin.normal.board_covariance
    return -sum(np.linalg.slogdet(inverse).logabsdet.sum() for inverse in inverses) / 2


def test_stations_do_not_pull_at_the_levers_of_the_camera():
    """In motion on a flat floor, 400 images pulled the head up by ten sigmas of what they show of its height."""
    case = imperfect.Case(motion="moving", images=20, noise=imperfect.CORRELATED)
    inference = Inference.of(case.extraction(0), Constraints())
    data, everything = inference.data, Inliers.all_of(inference.data)
    state = start_state(data, parameters_of(imperfect.ROBOTS[case.robot]), everything)
    noise = Noise(**Noise.limits("guess"), wider={})
    lin, _ = optimize(Posterior.at(state, everything, noise, inference.priors(state)))
    squares, redundancy = _lengths(lin)
    bias, normal, h = expected_gradient(lin) * max(redundancy / squares, 1.0), lin.normal, 1e-3
    for name in (
        "r_y",
        "r_z",
        "t_x",
        "t_y",
        "t_z",
        *(f"{joint}_position_x" for joint in ("pan", "tilt")),
        "tilt_position_z",
    ):
        k = data.layout.names.index(name)
        along = np.eye(data.layout.size)[k]
        others = (by[..., k] for by in (normal.board_by_shared, normal.base_by_shared, normal.own_by_shared))
        followed = [along, *others]
        more, less = (
            half_log_determinant(lin.after(Step(*(s * part for part in followed)))) for s in (h, -h)
        )
        assert bias[k] == pytest.approx((less - more) / (2 * h), rel=0.1), name
