"""report.json, from solutions of simulated robots."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.export import params
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood.constants import corrected_chain
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.numbers import image_coverage
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import constraints_of, solve
from tests.pairs import with_views
from tests.report.example import (
    HOSTILE,
    drawn,
    hostile_solution,
    made,
    make_extraction,
    make_hostile,
    params_of,
    recorded,
    report_on,
)


def test_json_holds_every_number(extraction, solution):
    text = json_text(made(solution, extraction))
    assert text == json_text(made(solution, extraction))
    data = json.loads(text)
    assert text == json.dumps(data, indent=1, sort_keys=True) + "\n"
    assert data["schema_version"] == 7
    assert data["verdict"]["level"] == "PASS"
    assert data["parameters"]["radius_left_mm"] == pytest.approx(
        solution.parameters.wheels.radius_left_m * 1e3, rel=1e-15
    )
    assert len(data["stations"]) == 12
    assert len(data["legs"]) == 11
    assert len(data["linear"]["history"]) == solution.linear.rounds
    second = solution.linear.rival_point_rms_m
    assert data["linear"]["second_best_point_rms_mm"] == pytest.approx(1e3 * second)
    assert math.sqrt(np.mean([leg["point_rms_mm"] ** 2 for leg in data["legs"]])) == pytest.approx(
        data["quality"]["point_rms_mm"]
    )
    assert data["rejections"]["counts"][0] == {
        "stage": "vision", "reason": "board partly hidden", "count": 2,
    }  # fmt: skip


def test_json_takes_hostile_strings(solution, extraction):
    hostile = make_hostile(extraction)
    text = json_text(made(hostile_solution(solution, hostile), hostile))
    assert text.isascii()
    assert json.loads(text)["notes"] == [HOSTILE]


def test_coverage_counts_cells():
    corners = np.array([[0, 0], [639, 479], [10, 10], [-5, 3], [700, 3]], dtype=np.float64)
    extraction = make_extraction()
    view = Corners(corners, 0.1, 1)
    seen = [with_views(o, right=view) for o in extraction.observations]
    assert image_coverage(replace(extraction, observations=tuple(seen)), 1) == pytest.approx(2 / 48)


@cache
def of_the_right_camera():
    extraction = recorded({"stereo_r_x": np.radians(0.7)})
    cameras = replace(extraction.rig.cameras, reference="right")
    nominal = Nominal(wheels=extraction.rig.nominal.wheels)
    extraction = replace(extraction, rig=replace(extraction.rig, cameras=cameras, nominal=nominal))
    return solve(extraction, constraints=constraints_of([], [], ["stereo_rotation"])), extraction


def test_the_right_camera_has_the_estimated_pose_in_the_pair():
    """The recording shows where the right camera is; camera_info is off by 0.7 degrees."""
    solution, extraction = of_the_right_camera()
    robot = TICK_ROBOT
    turn = se3.transform(se3.exp_so3(np.radians([0.7, 0, 0])), np.zeros(3))
    T_c_r = extraction.rig.cameras.T_c_each[1].copy()
    T_c_r[:3, :3] = turn[:3, :3] @ T_c_r[:3, :3]
    truth = robot.T_h_c @ T_c_r
    written = parameters_from_yaml(params_of(solution, extraction))
    data = json.loads(json_text(made(solution, extraction)))
    shown = se3.from_quaternion_xyzw(np.array(data["parameters"]["quaternion_xyzw"]))
    for R in (written.T_parent_child[:3, :3], shown):
        off_deg = np.degrees(np.linalg.norm(se3.log_so3(R @ truth[:3, :3].T)))
        assert off_deg < 0.45  # one sigma of the three rotations together is 0.31 degrees


def test_the_right_camera_has_its_own_covariance_and_jackknife():
    """The pose of the right camera also depends on the estimated pair; small moves, numerically."""
    solution, _ = of_the_right_camera()
    found = solution.uncertainty
    std = np.sqrt(np.diag(found.reference_covariance))
    lever = np.eye(9)
    t = solution.parameters.T_h_c[:3, :3] @ solution.cameras.T_c_each[1][:3, 3]
    lever[3:6, :3] = -se3.skew(t)
    as_if_exact = np.sqrt(np.diag(lever @ found.covariance @ lever.T))
    assert not np.allclose(std[:6], as_if_exact[:6], rtol=1e-3)
    assert std[6:] == pytest.approx(found.std[6:])
    ratio = found.jackknife_std[3:6] / std[3:6]
    assert ((ratio > 0.3) & (ratio < 3)).all()


def test_params_yaml_keeps_all_noise_levels():
    solution, extraction = drawn()
    noise = solution.uncertainty.noise
    written = parameters_from_yaml(params_of(solution, extraction))
    for level in ("pixel_px", "joint_rad", "floor_rad", "floor_m", "stamp_s", "wheel_share"):
        assert written.knowledge.noise[level] == pytest.approx(getattr(noise, level), rel=1e-8)


def test_a_report_renders_params_yaml_once(solution, extraction, monkeypatch):
    rendered, names = params.rendered, []
    monkeypatch.setattr(params, "rendered", lambda name, **of: names.append(name) or rendered(name, **of))
    report_on(solution, extraction)
    assert names == ["params.yaml", "verdict.yaml"]


def test_the_camera_of_a_station_is_where_the_estimate_has_it():
    """With the estimated constants: the poses of the stated cameras had moved it by centimeters."""
    solution, extraction = drawn()
    station = made(solution, extraction).stations[3]
    T_v_w, T_w_c = (np.vstack([T, [0, 0, 0, 1]]) for T in (station.T_world_base, station.T_world_camera))
    T_v_w = se3.inverse(T_v_w)
    values = {name: constant.value for name, constant in solution.constants.items()}
    chain, zeros = corrected_chain(extraction.rig.chain, values)
    scales = [1 + values[f"{name}_scale"] for name in ("pan", "tilt")]
    expected = (
        head_pose(chain, extraction.observations[3].joints * scales + zeros) @ solution.parameters.T_h_c
    )
    assert T_v_w @ T_w_c == pytest.approx(expected, abs=2e-3)  # but for backlash
