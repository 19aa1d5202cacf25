"""Verdict by use, contradictions, error budget and error parts, from solutions of simulated robots."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.export import parameters_from_yaml, params_yaml
from mobilecal_cli.model import CAMERA_INFO_CHANGES, NINE, LogSource, Nominal
from mobilecal_cli.report.decomposition import error_parts
from mobilecal_cli.report.findings import contradiction_sentences, jackknife_sentence
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.numbers import std_text
from mobilecal_cli.report.text import summary_text
from mobilecal_cli.report.use import (
    FAMILIES,
    FIGURES,
    SOURCES,
    families,
    limiting_sentence,
    recommendation,
    shares_of,
    uses,
)
from mobilecal_cli.report.verdict import gates_of, judge
from mobilecal_cli.simulate.ideal import Noise
from mobilecal_cli.simulate.imperfect import STATION_NOISE, Imperfection, draw, imperfect_extraction
from mobilecal_cli.simulate.robot import tick_robot
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import constraints_of, solve
from tests.report.example import made, make_extraction, make_provenance, make_solution, page_of, rows_of
from tests.report.schema import validated

NOISE = replace(STATION_NOISE, pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=5e-4)
QUIET = Noise(pixel_px=0.02, wheel_rad_per_sqrt_rad=1e-5, joint_rad=1e-6)


def recorded(constants, noise=NOISE, motion="standard", stations=12, seed=1):
    robot = tick_robot()
    route = plan_route(robot, motion, stations, seed=seed)
    extraction = imperfect_extraction(robot, route, Imperfection(constants, noise), seed=seed)
    nominal = Nominal(robot.T_h_c @ extraction.rig.cameras.T_c_reference, robot.wheels)
    rig = replace(extraction.rig, nominal=nominal)
    return replace(extraction, rig=rig, logs=(LogSource("log.mcap", "0" * 64),))


@cache
def solved(*constants, motion="standard", fixed=()):
    extraction = recorded(dict(constants), motion=motion)
    return solve(extraction, constraints=constraints_of(list(fixed), [], [])), extraction


@cache
def drawn():
    extraction = recorded(draw(tick_robot(), np.random.default_rng(1)))
    return solve(extraction), extraction


def with_share(solution, source, share):
    """The solution with a budget in which one source has a share of everything."""
    budget = solution.uncertainty.budget
    at = budget.sources.index(source)
    rest = (1 - share) / (len(budget.sources) - 1)
    column = np.full(len(budget.sources), rest)
    column[at] = share
    budget = replace(
        budget, nine=np.repeat(column[:, None], 9, axis=1), at_work=dict.fromkeys(budget.at_work, column)
    )
    return replace(solution, uncertainty=replace(solution.uncertainty, budget=budget))


# -- verdict by use ---------------------------------------------------------------------------------


def test_a_robot_drawn_from_the_priors_passes():
    solution, extraction = drawn()
    verdict = judge(solution, extraction)
    assert verdict.level == "PASS", verdict.reason
    assert "All are within their limits." in verdict.reason
    assert verdict.next_step.startswith("Use params.yaml on the robot.")


def test_the_limits_are_those_of_the_page():
    text = (Path(__file__).parents[2] / "docs" / "how-to" / "read-the-report.md").read_text()
    for figure in FIGURES:
        if figure.limit is not None:
            assert f"| `{figure.name}` | {figure.limit:g} {figure.unit} |" in text


def test_an_expected_error_beyond_its_limit_is_not_enough_and_names_what_limits_it():
    solution, extraction = drawn()
    at_work = replace(solution.uncertainty.at_work, camera_m=0.025)
    verdict = judge(replace(solution, uncertainty=replace(solution.uncertainty, at_work=at_work)), extraction)
    assert verdict.level == "NOT ENOUGH"
    assert "camera position in the base is 25 mm (limit 20 mm)" in verdict.reason
    assert "% of its variance" in verdict.reason


@pytest.mark.parametrize(("limit", "level"), [(0.01, "NOT ENOUGH"), (1e3, "PASS")])
def test_a_gate_replaces_a_default_limit(limit, level):
    solution, extraction = drawn()
    gates = gates_of([f"predicted.camera_mm={limit}"], {})
    verdict = judge(solution, extraction, gates)
    assert verdict.level == level
    check = verdict.checks["predicted.camera_mm"]
    assert (check.limit, check.unit) == (limit, "mm")
    assert check.value == verdict.metrics["predicted.camera_mm"]
    assert check.limit_text == f"at most {limit:g} mm"


def test_a_gate_on_an_unknown_expected_error_fails():
    extraction = make_extraction()
    gates = gates_of(["predicted.camera_mm=10"], {})
    verdict = judge(make_solution(extraction), extraction, gates)
    assert (verdict.level, verdict.reason) == (
        "FAIL",
        "Gate failed: predicted.camera_mm = unknown (limit 10).",
    )


@pytest.mark.parametrize(
    ("motion", "fixed"),
    [
        ("base_fixed", "wheels"),
        ("head_fixed", "head_eye"),
    ],
)
def test_fixed_parameters_need_no_motion(motion, fixed):
    solution, extraction = solved(motion=motion, fixed=(fixed,))
    verdict = judge(solution, extraction)
    assert verdict.level == "PASS", verdict.reason


def test_a_base_at_rest_does_not_show_the_zero_of_the_pan_joint():
    narrow = gates_of(["predicted.camera_deg=0.2"], {})
    verdict = judge(*solved(motion="base_fixed", fixed=("wheels",)), narrow)
    assert verdict.level == "NOT ENOUGH"
    assert "The stated geometry of the head limits the camera rotation in the base" in verdict.reason
    assert "More stations will not help much" in verdict.next_step
    assert verdict.next_step.endswith("`priors: joint_zero` in rig.yaml.")


def test_a_base_at_rest_is_not_enough_for_the_wheels():
    verdict = judge(*solved(motion="base_fixed"))
    assert verdict.level == "NOT ENOUGH"
    assert "drive and turn the base" in verdict.next_step


def test_methods_without_standard_deviations_say_so():
    extraction = make_extraction()
    for method, solution in ((method, make_solution(extraction, method)) for method in ("lm", "linear")):
        verdict = judge(solution, extraction)
        assert f"The method {method} gives no standard deviations" in verdict.reason
        assert "--method ml" in verdict.next_step
        assert "Use params.yaml" not in verdict.next_step


def test_an_unevenness_of_the_floor_is_contradiction_sentences():
    solution, extraction = drawn()
    noise = replace(solution.uncertainty.noise, floor_rad=np.radians(0.5))
    verdict = judge(replace(solution, uncertainty=replace(solution.uncertainty, noise=noise)), extraction)
    assert verdict.level == "PASS"
    assert "The noise of the floor (roll and pitch of the base) is 0.5 degrees" in verdict.next_step
    rows = rows_of(made(solution, extraction), "uncertainty", "Measurement noise")
    assert rows["floor: roll and pitch under the base"][1] == "deg"
    assert not any("time stamp" in meaning for meaning in rows)  # the robot stands at each station


# -- contradictions ---------------------------------------------------------------------------------


def test_a_turned_camera_is_named_with_its_cure():
    solution, extraction = solved(("stereo_r_x", np.radians(0.5)))
    (found,) = solution.contradictions
    what, cure = contradiction_sentences(found, solution, extraction)
    assert what.startswith("Right camera: rotation about the left camera's x differs by +0.")
    assert what.endswith("deg from camera_info (prior 0.050 deg).")
    assert cure == "Recalibrate the stereo pair, or use the exported camera_info."
    value, std = found.values["stereo_r_x"]
    assert abs(value - np.radians(0.5)) < 4 * std
    assert what in " ".join(summary_text(made(solution, extraction)).split())
    (table,) = (table for table in made(solution, extraction).tables if table.section == "constants")
    part, name, _, _, _, prior, _, tag = table.rows[0]
    assert (part, name, prior, tag) == ("right camera", "stereo_r_x", "0.050", "contradicts")


@pytest.mark.parametrize(("shift", "level"), [(1.9, "PASS"), (2.1, "FAIL")])
def test_a_contradiction_fails_where_the_result_depends_on_it(shift, level):
    solution, extraction = solved(("stereo_r_x", np.radians(0.5)))
    found = replace(solution.contradictions[0], shift_sigmas=shift)
    verdict = judge(replace(solution, contradictions=(found,)), extraction)
    assert verdict.level == level
    assert "Right camera" in verdict.reason + verdict.next_step


def test_squares_and_baseline_disagree_together():
    solution, extraction = solved(("square_scale", 0.02))
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("The stated squares and the stereo baseline disagree by ")
    assert "The recording cannot tell which of the two is wrong." in verdict.next_step
    assert solution.scale.ratio == pytest.approx(1.02, abs=0.005)


def test_no_stated_size_is_named_where_none_is_stated():
    solution, extraction = solved(("square_scale", 0.02))
    found = next(one for one in solution.contradictions if one.kind == "square_size")
    unstated = replace(extraction, board=replace(extraction.board, square_m=None))
    what, cure = contradiction_sentences(found, replace(solution, scale=None), unstated)
    assert what.startswith("Board: size of the squares differs by ")
    assert "from the size that the stereo pair measures at each station (prior " in what
    assert cure == "Check that camera_info belongs to these images, and state board.square_m in rig.yaml."


def test_constants_that_the_recording_shows_only_together_are_named():
    solution, extraction = solved(("stereo_r_x", np.radians(0.5)))
    (found,) = solution.contradictions
    together = replace(found, values={name: (value, np.inf) for name, (value, _) in found.values.items()})
    what, _ = contradiction_sentences(together, solution, extraction)
    assert what.startswith("Right camera: rotation about the left camera's x and rotation about")
    assert what.endswith(" together differ from camera_info (prior 0.050 deg).")


# -- error budget -----------------------------------------------------------------------------------


def test_the_words_know_every_source():
    solution, _ = drawn()
    assert set(solution.uncertainty.budget.sources) <= set(SOURCES)
    names, shares = families(solution)
    assert len(names) == len(shares)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, atol=1e-6)


def test_the_recommendation_is_about_the_figure_closest_to_its_limit():
    solution, _ = drawn()
    worst = max(uses(solution, {}), key=lambda use: use.share)
    limiting, _ = recommendation(with_share(solution, "pixel_px", 0.62))
    assert limiting == f"Corner noise limits the {worst.figure.meaning}: 62 % of its variance."


def test_more_stations_do_not_help_against_stated_values():
    solution, _ = drawn()
    _, advice = recommendation(with_share(solution, "square_size", 0.8))
    assert advice.startswith("More stations will not help much: ")
    assert "the stated size of the squares 80 %" in advice
    assert advice.endswith(
        "Measure the board (ten squares, with a caliper). Then state a smaller `priors: square_size` in rig.yaml."
    )
    _, advice = recommendation(with_share(solution, "floor_rad", 0.9))
    assert advice == "Record on a flat floor, or record more stops."


def test_the_files_hold_budget_and_constants():
    solution, extraction = solved(("stereo_r_x", np.radians(0.5)))
    data = validated(json_text(made(solution, extraction)))
    for shares in (*data["error_budget"]["nine"].values(), *data["error_budget"]["at_work"].values()):
        assert sum(shares.values()) == pytest.approx(1.0)
    assert data["constants"]["stereo_r_x"]["prior"] == pytest.approx(np.radians(0.05))
    assert data["constants"]["stereo_r_x"]["used_prior"] > data["constants"]["stereo_r_x"]["prior"]
    assert data["contradictions"][0]["cure"].startswith("Recalibrate the stereo pair")
    page = page_of(solution, extraction)
    for said in (
        "What the description gets wrong",
        "Error budget",
        "contradicts",
        "error budget: what each",
    ):
        assert said in page


# -- parts of the reprojection error ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "noise"),
    [
        ("floor", replace(QUIET, floor_rad=np.radians(0.3))),
        ("joints", replace(QUIET, joint_rad=np.radians(0.2))),
        ("wheels", replace(QUIET, wheel_rad_per_sqrt_rad=0.01)),
    ],
)
def test_one_noise_alone_makes_the_reprojection_error(part, noise):
    """With true levels, the prediction for one noise is the error that it makes."""
    extraction = recorded({}, noise, stations=40)
    solution = solve(extraction, "lm")
    levels = {name: getattr(noise, name) for name in ("pixel_px", "wheel_rad_per_sqrt_rad", "joint_rad")}
    levels |= {"floor_rad": noise.floor_rad, "floor_m": 0.0, "wheel_share": 0.0}
    uncertainty = drawn()[0].uncertainty
    true = replace(uncertainty, noise=replace(uncertainty.noise, **levels))
    known = replace(solution, uncertainty=true)
    parts = error_parts(known, extraction)
    assert max(parts, key=lambda name: parts[name].px) == part
    whole = np.sqrt(sum(p.px**2 for p in parts.values()))
    assert solution.reprojection_rms_px == pytest.approx(whole, rel=0.25)
    assert f"together {std_text(whole)} px" in made(known, extraction).quality.reprojection_text


def test_a_small_corner_noise_is_not_rounded_to_zero():
    solution, extraction = drawn()
    noise = replace(solution.uncertainty.noise, pixel_px=0.0041)
    quiet = replace(solution, uncertainty=replace(solution.uncertainty, noise=noise))
    assert "has a noise of 0.0041 px" in made(quiet, extraction).quality.reprojection_text


def test_the_sentence_and_the_chart_group_the_sources_alike():
    solution, _ = drawn()
    names, shares = families(solution)
    column = [*NINE, *solution.uncertainty.budget.at_work].index("heading_rad_per_turn")
    share = dict(zip(names, shares[:, column], strict=True))
    family = max(share, key=share.get)
    sentence = limiting_sentence(shares_of(solution, "heading_rad_per_turn"), "heading")
    assert sentence == f"{FAMILIES[family]} the heading: {100 * share[family]:.0f} % of its variance."


def test_a_fixed_camera_is_not_known_to_zero_millimeters():
    solution, extraction = drawn()
    at_work = replace(solution.uncertainty.at_work, camera_m=0.0, camera_rad=0.0)
    fixed = replace(solution, uncertainty=replace(solution.uncertainty, at_work=at_work))
    verdict = judge(fixed, extraction)
    assert "camera in the base fixed by the user; dead reckoning" in verdict.reason
    assert verdict.checks["predicted.camera_mm"].measured_text == "fixed by the user"


def test_a_camera_info_that_changes_is_no_silent_pass():
    solution, extraction = drawn()
    note = f"/left/camera_info: {CAMERA_INFO_CHANGES} 3.0 s after the start: K by up to 5 px"
    verdict = judge(solution, replace(extraction, notes=(note,)))
    assert verdict.level == "PASS"
    assert f"Check first: {note}." in verdict.next_step


# -- reference camera -------------------------------------------------------------------------------


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
    robot = tick_robot()
    turn = se3.transform(se3.exp_so3(np.radians([0.7, 0, 0])), np.zeros(3))
    T_c_r = extraction.rig.cameras.T_c_r.copy()
    T_c_r[:3, :3] = turn[:3, :3] @ T_c_r[:3, :3]
    truth = robot.T_h_c @ T_c_r
    written = parameters_from_yaml(params_yaml(solution, extraction, make_provenance(extraction)))
    data = json.loads(json_text(made(solution, extraction)))
    shown = se3.from_quaternion_xyzw(np.array(data["parameters"]["quaternion_xyzw"]))
    for R in (written.T_parent_child[:3, :3], shown):
        off_deg = np.degrees(np.linalg.norm(se3.log_so3(R @ truth[:3, :3].T)))
        assert off_deg < 0.35


def test_a_fixed_head_eye_transform_is_that_of_the_right_camera():
    """The left camera follows from the estimated pair; the right one is exactly as stated."""
    _, extraction = of_the_right_camera()
    nominal = Nominal(tick_robot().T_h_c @ extraction.rig.cameras.T_c_r, extraction.rig.nominal.wheels)
    extraction = replace(extraction, rig=replace(extraction.rig, nominal=nominal))
    solution = solve(extraction, constraints=constraints_of(["head_eye"], [], ["stereo"]))
    assert not np.allclose(solution.parameters.T_h_c, tick_robot().T_h_c, atol=5e-3)
    provenance = make_provenance(extraction)
    written = parameters_from_yaml(params_yaml(solution, extraction, provenance))
    data = json.loads(json_text(made(solution, extraction)))["parameters"]
    shown = se3.transform(
        se3.from_quaternion_xyzw(np.array(data["quaternion_xyzw"])), np.array(data["translation_m"])
    )
    for T in (written.T_parent_child, shown):
        np.testing.assert_allclose(T, nominal.T_h_reference, atol=1e-6)
    assert not solution.uncertainty.reference_covariance[:6].any()


def test_the_right_camera_has_its_own_covariance_and_jackknife():
    """The pose of the right camera also depends on the estimated pair; small moves, numerically."""
    solution, _ = of_the_right_camera()
    found = solution.uncertainty
    std = np.sqrt(np.diag(found.reference_covariance))
    lever = np.eye(9)
    t = solution.parameters.T_h_c[:3, :3] @ solution.cameras.T_c_r[:3, 3]
    lever[3:6, :3] = -se3.skew(t)
    as_if_exact = np.sqrt(np.diag(lever @ found.covariance @ lever.T))
    assert not np.allclose(std[:6], as_if_exact[:6], rtol=1e-3)
    assert std[6:] == pytest.approx(found.std[6:])
    ratio = found.jackknife_std[3:6] / found.noise_std[3:6]
    assert ((ratio > 0.3) & (ratio < 3)).all()


def test_params_yaml_keeps_all_noise_levels():
    solution, extraction = drawn()
    noise = solution.uncertainty.noise
    written = parameters_from_yaml(params_yaml(solution, extraction, make_provenance(extraction)))
    for level in ("pixel_px", "joint_rad", "floor_rad", "floor_m", "stamp_s", "wheel_share"):
        assert written.knowledge.noise[level] == pytest.approx(getattr(noise, level), rel=1e-8)


def test_an_extraction_without_logs_has_a_report():
    solution, extraction = drawn()
    nameless = replace(extraction, logs=())
    page = page_of(solution, nameless)
    assert "top view of the base path" in page


# -- jackknife --------------------------------------------------------------------------------------


def test_the_jackknife_widens_sigmas_that_are_too_small():
    right, extraction = drawn()
    assert (right.uncertainty.widened == 1).all()
    assert "therefore" not in jackknife_sentence(right)
    given = replace(
        extraction.rig.noise,
        pixel_px=0.04,
        joint_rad=2e-4,
        wheel_rad_per_sqrt_rad=1e-3,
        wheel_share=2e-4,
        floor_rad=np.radians(0.02),
        floor_m=2e-4,
        sway_rad=1e-6,
        sway_m=1e-6,
    )
    found = solve(replace(extraction, rig=replace(extraction.rig, noise=given)))
    uncertainty = found.uncertainty
    wide = uncertainty.widened > 1
    assert wide.any()
    np.testing.assert_allclose(uncertainty.std[wide], uncertainty.jackknife_std[wide])
    assert "are therefore those of the jackknife" in jackknife_sentence(found)
