"""The whole solver on simulated drives with known truth."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.solve import _require_possible
from tests.bench.imperfect import Case
from tests.extractions import Noise, Outside, extraction_of, simulated
from tests.truth import errors


def test_a_robot_in_motion_gives_the_truth():
    """Large turns: tests/solvers/test_linear.py. Stamps are whole nanoseconds: 0.5 ns at 5 rad/s of a wheel are left."""
    robot = ROBOTS["paper"]
    solution = solve(simulated("moving", robot=robot, seed=0, nominal=False, images=12))
    assert np.abs(errors(solution.parameters, robot)).max() < 1e-7


@pytest.mark.parametrize(
    ("radius_m", "separation_m", "said"),
    [
        (-0.1, 0.4, "a negative value"),
        (1.7e-8, 0.4, "beyond 0.001 to 10 m"),
        (0.1, 6e-3, "beyond 0.01 to 100 m"),
    ],
)
def test_wheels_that_are_not_possible_are_no_result(radius_m, separation_m, said):
    """They were an error of params.yaml, "use a params.yaml written by mobilecal calibrate"."""
    with pytest.raises(SolveError, match=said):
        _require_possible(WheelGeometry(radius_m, radius_m, separation_m))


def test_residuals_and_the_world_fit_together():
    robot = ROBOTS["paper"]
    route = plan_route(robot)
    extraction = extraction_of(robot, route, Noise(pixel_px=0.2), seed=1)
    solution = solve(extraction, "lm")
    residuals = solution.residuals
    whole = np.sqrt(np.mean(residuals.leg_point_rms_m**2))
    assert whole == pytest.approx(solution.point_rms_m)
    assert np.sqrt(np.mean(residuals.leg_reprojection_px**2)) == pytest.approx(solution.reprojection_rms_px)
    # The world is the base at the first station, which the simulator has at its own origin.
    assert residuals.T_w_k[:, :3, 3] == pytest.approx(np.tile(route.T_w_k[:3, 3], (12, 1)), abs=0.1)
    poses = route.drive.poses(route.rests_s.mean(axis=1))
    assert residuals.T_w_v[:, :2, 3] == pytest.approx(poses[:, :2], abs=0.05)


def test_motion_is_told():
    motion = solve(simulated(seed=0), "linear").motion
    assert set(motion) == {"pan_range_deg", "tilt_range_deg", "turned_deg", "largest_turn_deg", "driven_m"}
    assert 40 < motion["pan_range_deg"] < 150
    assert 2 < motion["driven_m"] < 20


def test_what_the_lenses_do_beside_their_models_is_a_part_of_the_errors():
    """Waves of 0.2 px make the depths of the corners wrong by about their noise."""
    waves = Outside(lens_px=0.2, lens_waves_px=(320.0, 1280.0))
    solution = solve(Case(stations=16, outside=waves).extraction(2))
    parts, noise_m = solution.error_parts, solution.residuals.corner_noise_m
    assert solution.point_rms_m > 1.3 * noise_m
    assert np.hypot(noise_m, parts["lenses"].m) == pytest.approx(solution.point_rms_m, rel=0.1)
    assert 0 < parts["lenses"].px < solution.reprojection_rms_px


def test_corners_that_were_not_detected_are_where_the_estimated_board_has_them():
    """A principal point that is 8 px off displaces the stated board by 5 % of its distance."""
    whole = Case(stations=16, fixed={"principal_left_x": 0.0125}).extraction(0)
    seen = []
    for o in whole.observations:
        shown = np.arange(len(o.points_c)) % 2 == o.station % 2
        views = tuple(replace(view, seen=shown) for view in o.views)
        points_c = np.where(shown[:, None], o.points_c, se3.act(o.T_c_k[None], _corners(whole))[0])
        seen.append(replace(o, views=views, points_c=points_c))
    solution = solve(replace(whole, observations=tuple(seen)))
    explained = np.linalg.norm([part.m for part in solution.error_parts.values()])
    assert solution.point_rms_m < 1.5 * explained


def _corners(extraction):
    return extraction.board.grid() * extraction.square_m
