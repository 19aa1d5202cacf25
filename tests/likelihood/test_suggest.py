"""Further stops that a solution suggests."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.calibrate.steps import fitted
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood import suggest
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.report.findings import suggestion_sentences
from mobilecal_cli.simulate.robot import PAPER_ROBOT, pixels
from mobilecal_cli.solvers import Constraints, solve
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.maximum_likelihood import robust_fit
from tests.extractions import Noise, in_view, simulated
from tests.robots import CONFIGURATIONS, chain_of

NOISE = Noise(0.1, 0.003, 0.0, 1e-4, floor_rad=1e-3, floor_m=5e-4)


def test_they_name_what_is_worst_and_would_help():
    noise = Noise(0.2, 0.003, 0.0, np.radians(0.05))
    solution = solve(simulated(noise=noise, seed=1))
    assert 1 <= len(solution.suggestions) <= 3
    gains = [s.gain for s in solution.suggestions]
    assert gains == sorted(gains, reverse=True)
    assert 0 < gains[0] < 0.7
    std = dict(zip(NINE, solution.uncertainty.std, strict=True))
    for suggestion in solution.suggestions:
        assert suggestion.std_now == pytest.approx(std[suggestion.worst], rel=0.3)
        assert suggestion.std_then < suggestion.std_now
        assert len(suggestion.joints) == len(chain_of(PAPER_ROBOT).joints)
    best = solve(simulated("straight", noise, seed=3)).suggestions[0]
    assert best.worst == "separation"
    assert best.turn_rad != 0
    assert best.std_then < 0.01


@pytest.mark.parametrize("configuration", [(1, "none"), (2, "none"), (1, "pan")])
def test_stops_are_suggested_for_cameras_that_no_joint_pans_or_tilts(configuration):
    robot = CONFIGURATIONS[configuration]
    extraction = simulated("standard", NOISE, robot, 8, 1)
    solution = fitted(extraction).solution
    assert solution.suggestions
    assert all(s.worst != "t_z" and s.gain > 0 for s in solution.suggestions)
    sentences = suggestion_sentences(solution, extraction)
    for suggestion, sentence in zip(solution.suggestions, sentences, strict=True):
        turns_deg = np.degrees([suggestion.turn_rad, suggestion.face_rad])
        assert ("Set pan_joint to" in sentence) == (configuration[1] == "pan")
        assert ("degrees" in sentence) == np.round(turns_deg).any()
        T = solution.residuals.T_w_v[-1]
        for turn, drive in ((suggestion.turn_rad, suggestion.drive_m), (suggestion.face_rad, 0.0)):
            T = T @ se3.transform(se3.rotation_z(np.array(turn)), np.zeros(3))
            T = T @ se3.transform(np.eye(3), np.array([drive, 0.0, 0.0]))
        T_w_c = T @ head_pose(chain_of(robot), suggestion.joints) @ robot.T_h_c
        points = se3.act(se3.inverse(T_w_c) @ solution.residuals.T_w_k[-1], extraction.board.grid() * 0.08)
        assert in_view(robot.rig_cameras.first, pixels(robot.rig_cameras.first, points))


def test_a_camera_that_does_not_show_the_board_tells_nothing():
    """One looks aside: as if it saw the board behind it, "the measurements do not determine all parameters"."""
    extraction = simulated("standard", NOISE, CONFIGURATIONS[3, "pan-tilt"], 8, 1)
    lin = robust_fit(Inference.of(extraction, Constraints())).lin
    cameras = lin.state.cameras
    away = se3.transform(Rotation.from_euler("y", 75, degrees=True).as_matrix(), np.zeros(3))
    turned = replace(cameras, T_c_each=np.concatenate([cameras.T_c_each[:2], away[None]]))
    seen = lin.data.seen.copy()
    seen[:, 2] = False
    state = replace(lin.state, data=replace(lin.data, cameras=turned, seen=seen))
    ways, joints = suggest._reachable(state)
    stops = suggest._with_stops(replace(lin, state=state), ways, joints)
    assert len(ways) > 3
    assert stops.data.seen[2:, :2].all()
    assert not stops.data.seen[2:, 2].any()
    for A in suggest._shown(stops):
        assert np.abs(A).max() < 1e12
    all_fixed = np.zeros_like(lin.covariance)
    assert suggest.suggestions(lin, all_fixed) == ()


def test_a_stop_that_the_base_turns_far_for_is_among_the_suggested():
    """The aim was given up half-way: the best of these stops promised half as much."""
    noise = Noise(0.1, 0.003, 0.001, 5e-4)
    best, *_ = solve(simulated(noise=noise, robot="rgbd")).suggestions
    assert abs(best.face_rad) > 1.2
    assert best.gain > 0.5
