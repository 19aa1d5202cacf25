"""Legs and views at known states: derivatives against differences, variances in closed form, images in motion."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.corners import corner_residuals
from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.likelihood.legs import leg_covariances, linearize_legs
from mobilecal_cli.likelihood.processes import processes_of
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.measured import from_motions
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers.initial import start_state
from tests.actual import draw
from tests.extractions import simulated
from tests.robots import chain_of
from tests.solvers import test_measured
from tests.truth import no_priors, parameters_of

LEVELS = Noise.exact(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=1e-3)


def test_motions_of_a_planar_sensor_have_the_derivatives_of_differences():
    wheels, T_v_c = test_measured.WHEELS, test_measured.T_V_C
    data = dataset_of(from_motions(test_measured.legs(5, 1), tuple(wheels.vector), T_v_c))
    everything, random = Inliers.all_of(data), np.random.default_rng(0)
    at = start_state(data, Parameters(T_v_c, wheels), everything)
    processes = processes_of(at, LEVELS, everything)

    def residual(state):
        return linearize_legs(state, processes)

    def step(size):
        base = random.normal(size=(data.stations, data.base_width)) * size
        base[data.first, :3] = 0.0
        still = np.zeros((data.logs, 6)), base, np.zeros((data.stations, data.own_width))
        return Step(random.normal(size=data.layout.size) * size, *still)

    at = at.plus(step(1e-2))
    for _ in range(5):
        small = step(1e-6)
        back = Step(*(-getattr(small, part) for part in ("shared", "boards", "base", "own")))
        ends = [residual(at.plus(each)).residual for each in (small, back)]
        here = residual(at)
        predicted = here.moved(data, small).residual - here.residual
        assert predicted.shape[1] == 6
        # The heading is to first order in the sensor's tilt, here a hundredth of a radian.
        np.testing.assert_allclose((ends[0] - ends[1]) / 2, predicted, rtol=0, atol=1e-8)


def test_the_mean_scale_error_of_a_leg_with_known_ends_is_that_of_a_bridge():
    """By a fine grid: the variance of the mean of a process with covariance exp(-d), given its two ends."""
    extraction = simulated(robot="tick", stations=4, seed=1)
    steps, wheels = dataset_of(extraction).steps(), TICK_ROBOT.wheels
    noise = replace(LEVELS, wheel_share=0.01, wheel_length_m=0.5)
    alone = leg_covariances(steps, wheels, noise, ends_known=True)["wheel_share"]
    free = leg_covariances(steps, wheels, noise)["wheel_share"]
    for leg, rolled in enumerate(steps.totals_rad):
        one = np.bincount(steps.leg, weights=np.abs(steps.right_rad) * wheels.radius_right_m)[leg]
        other = np.bincount(steps.leg, weights=np.abs(steps.left_rad) * wheels.radius_left_m)[leg]
        variances = []
        for way_m in (one, other):
            s = np.linspace(0, way_m / 0.5, 400)
            C = np.exp(-np.abs(s[:, None] - s))
            mean = np.full(len(s), 1 / (len(s) - 1))
            mean[[0, -1]] /= 2
            ends = C[:, [0, -1]]
            left = C - ends @ np.linalg.solve(ends[[0, -1]], ends.T)
            variances.append((mean @ left @ mean, mean @ C @ mean))
        by_wheels = np.array([wheels.radius_right_m * rolled[0], -wheels.radius_left_m * rolled[1]])
        by_wheels *= 0.01 / wheels.separation_m
        for found, which in ((alone, 0), (free, 1)):
            heading = by_wheels**2 @ [pair[which] for pair in variances]
            assert found[leg, 2, 2] == pytest.approx(heading, rel=1e-3)


def test_a_prior_that_is_twice_as_wide_weighs_a_quarter():
    extraction = simulated(robot="tick", stations=4, seed=1)
    data = dataset_of(extraction, table(extraction.rig.cameras, extraction.rig.chain))
    priors = no_priors(data.layout, parameters_of(TICK_ROBOT))
    stated = np.ones(data.layout.size)
    priors = replace(priors, stated_weight=stated, alike=stated > 0).widened({"focal_length": 2.0})
    wide = np.array([name in ("focal_left", "focal_right") for name in data.layout.names])
    wide = np.pad(wide, (data.layout.size - len(wide), 0))
    assert wide.sum() == 2
    assert priors.weight.tolist() == np.where(wide, 0.25, 1.0).tolist()


@pytest.mark.parametrize(
    ("motion", "constants"),
    [
        ("moving", {"readout": 0.02}),
        ("moving", {"time_right": 0.01}),
        ("moving", {"time_joints": 0.02}),
        ("standard", draw(TICK_ROBOT, np.random.default_rng(0))),
    ],
    ids=["readout", "time_right", "time_joints", "all at rest"],
)
def test_corners_are_where_a_robot_with_these_constants_shows_them(motion, constants):
    """The state is that of a recording without them, so that nothing else can take them up.

    The robot's formulas are those of `tests.actual`: each constant counts there and here, alike.
    """
    robot = TICK_ROBOT
    rows = table(robot.rig_cameras, chain_of(robot))
    exact, data = (
        dataset_of(simulated(motion, robot=robot, seed=1, constants=each), rows) for each in ({}, constants)
    )
    state = replace(start_state(exact, parameters_of(robot), Inliers.all_of(exact)), data=data)
    names, shared = list(data.layout.names), np.zeros(data.layout.size)
    for name, value in constants.items():
        shared[data.layout.size - len(names) + names.index(name)] = value
    still = (np.zeros((data.stations, width)) for width in (data.base_width, data.own_width))
    with_constants = state.plus(Step(shared, np.zeros((1, 6)), *still))
    rms_px = []
    for at in (state, with_constants):
        off, _ = corner_residuals(at, at.T_c_k, rates=at.view_rates)
        rms_px.append(np.sqrt(np.mean(off**2, axis=(1, 2, 3))))
    assert np.median(rms_px[1] / rms_px[0]) < 0.03  # more where the speed changes within an image
    assert (
        motion == "moving" or rms_px[1].max() < 2e-4
    )  # the least of the constants displaces them by 0.002 px


def test_corners_with_no_constant_of_a_lens_are_exact():
    robot = TICK_ROBOT
    rows = [row for row in table(robot.rig_cameras, chain_of(robot)) if row.kind == "stereo_clock"]
    data = dataset_of(simulated(robot=robot, stations=4, seed=1), rows)
    state = start_state(data, parameters_of(robot), Inliers.all_of(data))
    off, _ = corner_residuals(state, state.T_c_k, rates=state.view_rates)
    assert np.abs(off).max() < 1e-9
