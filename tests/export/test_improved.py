"""Improved cameras and head chains, exported and read back by parsers that are not ours."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
import yourdfpy

from mobilecal_cli import se3
from mobilecal_cli.calibrate.evaluate import evaluate
from mobilecal_cli.calibrate.export import export
from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.export.improved import improved_cameras, improved_chain, without_correction
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.kinematics.urdf import chain_links, parse_urdf
from mobilecal_cli.likelihood.constants import camera_change, joint_keys, table
from mobilecal_cli.model.findings import EstimatedConstant
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import Camera, HeadChain, LensCorrection
from mobilecal_cli.rig.settings import settings_of
from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from mobilecal_cli.solvers import solve
from mobilecal_cli.targets import Target
from tests.actual import draw
from tests.export.test_urdf_patch import robot
from tests.extractions import simulated
from tests.formats import small_uncertainty
from tests.report.example import params_of
from tests.robots import rig_of

K = np.array([[550.0, 0, 322], [0, 552, 238], [0, 0, 1]])
CENTER = np.array([320.0, 240.0])


@pytest.fixture(scope="module", params=["paper", "tick"])
def calibrated(request, tmp_path_factory):
    """(robot, extraction, solution, params.yaml) of a robot that is not as described, with its true constants."""
    described = ROBOTS[request.param]
    extraction = simulated(robot=described, stations=4)
    extraction = replace(extraction, logs=(LogSource("log.mcap", "0" * 64),))
    drawn = draw(described, np.random.default_rng(3))
    constants = {
        row.name: EstimatedConstant(row.name, row.kind, row.part, row.meaning, drawn[row.name], 1e-4, 1e-3)
        for row in table(extraction.rig.cameras, extraction.rig.chain)
        if row.name in drawn
    }
    solution = replace(solve(extraction, "linear"), uncertainty=small_uncertainty(), constants=constants)
    directory = tmp_path_factory.mktemp(request.param)
    text = params_of(solution, extraction, "PASS", config=settings_of(extraction))
    (directory / "params.yaml").write_text(text, encoding="utf-8")
    (directory / "extraction.npz").write_bytes(extraction_to_npz(extraction))
    (directory / "robot.urdf").write_text(urdf_text(described), encoding="utf-8")
    return described, extraction, solution, directory / "params.yaml"


def values_of(solution):
    return {name: found.value for name, found in solution.constants.items()}


def fitted_cameras(extraction, solution):
    """The stereo pair of the fit, lens corrections included."""
    rig = extraction.rig
    return camera_change(rig.cameras, table(rig.cameras, rig.chain), values_of(solution)).apply(rig.cameras)


def over_the_image(camera):
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, 23), np.linspace(0, camera.height - 1, 17))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    flat, good = undistorted(camera, pixels)
    return np.column_stack([flat[good], np.ones(good.sum())]), pixels[good]


def stated_px(notes):
    (note,) = [note for note in notes if "px rms" in note]
    return float(note.split("at most ")[1].split(" px")[0])


def matrix(data, name):
    return np.array(data[name]["data"]).reshape(data[name]["rows"], data[name]["cols"])


def off_px(camera, K_made, D):
    """Largest distance of OpenCV's projection with written numbers from a camera's own, over the image."""
    rays, pixels = over_the_image(camera)
    found = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K_made, D)[0][:, 0]
    return np.linalg.norm(found - pixels, axis=1).max()


def test_camera_info_is_that_of_the_fitted_pair(calibrated):
    """R and P of both files: a point in the rectified frames of both cameras differs by the baseline alone."""
    _, extraction, solution, params = calibrated
    cameras, R = fitted_cameras(extraction, solution), []
    for fitted, stated, side in zip(cameras.each, extraction.rig.cameras.each, cameras.names, strict=True):
        made = export(params, Target[f"camera_info_{side}"])
        data = yaml.safe_load(made.content)
        assert data["distortion_model"] == "plumb_bob"
        K_made = matrix(data, "camera_matrix")
        assert pytest.approx(fitted.K, rel=1e-9) == K_made
        off = off_px(fitted, K_made, matrix(data, "distortion_coefficients")[0])
        assert off <= stated_px(made.notes) * 1.05
        assert off < off_px(fitted, stated.K, stated.D) / 5
        R.append(se3.transform(matrix(data, "rectification_matrix"), np.zeros(3)))
    P_right = matrix(data, "projection_matrix")
    T = R[0] @ cameras.T_c_each[1] @ se3.inverse(R[1])
    assert T[:3, :3] == pytest.approx(np.eye(3), abs=1e-8)
    assert T[:3, 3] == pytest.approx([-P_right[0, 3] / P_right[0, 0], 0, 0], abs=1e-8)


def test_the_urdf_with_the_chain_moves_as_the_fitted_head(calibrated, tmp_path):
    described, extraction, solution, params = calibrated
    made = export(params, Target.urdf, urdf=params.with_name("robot.urdf"), with_chain=True)
    path = tmp_path / "calibrated.urdf"
    path.write_bytes(made.content)
    reader = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    chain = improved_chain(extraction.rig.chain, values_of(solution))
    limits = [joint.limit_rad for joint in described.joints if joint.name]
    readings = np.random.default_rng(1).uniform(-1, 1, (20, len(limits))) * limits
    zeros = np.array([chain.zeros.get(name, 0.0) for name in chain.improved.joints])
    assert np.abs(zeros).max() > 1e-4
    T_v_c = head_pose(chain.improved, readings + zeros) @ solution.parameters.T_h_c
    stated = head_pose(extraction.rig.chain, readings) @ solution.parameters.T_h_c
    for q, T, T_stated in zip(readings, T_v_c, stated, strict=True):
        reader.update_cfg(dict(zip(chain.improved.joints, q, strict=True)))
        read = reader.get_transform("stereo_left_optical", "base_link")
        assert pytest.approx(T, abs=1e-6) == read
        assert np.abs(read - T_stated).max() > 5e-4
    (left_out,) = [note for note in made.notes if "no scale and no backlash" in note]
    assert "pan_scale" in left_out
    with pytest.raises(ConfigError, match="is not as in the calibrated robot's chain"):
        export(params, Target.urdf, urdf=path, with_chain=True)


def test_a_zero_of_the_first_joint_is_not_written_twice(calibrated, tmp_path):
    """The first origin was not compared: the chain starts between the wheels."""
    _, extraction, solution, params = calibrated
    zero = f"{next(iter(joint_keys(extraction.rig.chain).values()))}_zero"
    chain = improved_chain(extraction.rig.chain, {zero: values_of(solution)[zero]})
    once = patched_urdf(
        params.with_name("robot.urdf").read_bytes(), parameters_from_yaml(params.read_text()), {}, chain
    )
    with pytest.raises(ConfigError, match="is not as in the calibrated robot's chain"):
        patched_urdf(once.content, parameters_from_yaml(params.read_text()), {}, chain)


def test_exports_without_the_chain_say_how_far_the_camera_is_off(calibrated):
    _, extraction, solution, params = calibrated
    chain = extraction.rig.chain
    improved = improved_chain(chain, values_of(solution))
    zeros = np.array([improved.zeros[name] for name in chain.joints])
    before, after = (
        head_pose(of, at) @ solution.parameters.T_h_c
        for of, at in ((chain, 0 * zeros), (improved.improved, zeros))
    )
    off = se3.inverse(before) @ after
    deg, mm = np.degrees(np.linalg.norm(se3.log_so3(off[:3, :3]))), 1e3 * np.linalg.norm(off[:3, 3])
    for target in (Target.static_transform_yaml, Target.static_transform_launch, Target.xacro, Target.json):
        made = export(params, target)
        (note,) = [note for note in made.notes if "corrects the head chain" in note]
        assert f"{deg:.2g} degrees and {mm:.2g} mm away" in note
        assert target is Target.json or note in made.content.decode()


def test_a_description_that_was_corrected_is_not_corrected_again(calibrated, tmp_path):
    """The errors grew by what was corrected, on a recording of the robot with the exported URDF or camera infos."""
    _, extraction, solution, params = calibrated
    rig, path = extraction.rig, tmp_path / "extraction.npz"
    urdf = export(params, Target.urdf, urdf=params.with_name("robot.urdf"), with_chain=True).content
    links = chain_links(parse_urdf(urdf.decode()), rig.chain.base_frame, rig.chain.head_frame)
    written = {
        "": rig,
        "head chain is": replace(rig, chain=replace(rig.chain, links=links)),
        "camera infos are": replace(rig, cameras=improved_cameras(rig, values_of(solution))[0]),
    }
    errors = {}
    for words, corrected in written.items():
        path.write_bytes(extraction_to_npz(replace(extraction, rig=corrected)))
        result = evaluate([path], params)
        errors[words] = result.evaluation.rotation_rad
        assert [words in note for note in result.remarks] == [True] * bool(words)
    assert errors["head chain is"] == pytest.approx(errors[""], abs=5e-5)
    older = params.with_name("older.yaml")  # states no cameras: corrected twice
    older.write_text(re.sub(" *cameras_sha256.*", "", params.read_text("utf-8")), "utf-8")
    twice = evaluate([path], older).evaluation.rotation_rad
    once, again = (np.abs(each - errors[""]).max() for each in (errors["camera infos are"], twice))
    assert 3 * once < again


def test_calibrations_without_constants_have_no_improved_cameras(calibrated, tmp_path):
    _, extraction, _, params = calibrated
    text = params.read_text(encoding="utf-8")
    without = text[: text.index("constants:")] + text[text.index("# Provenance") :]
    (tmp_path / "params.yaml").write_text(without, encoding="utf-8")
    (tmp_path / "extraction.npz").write_bytes(params.with_name("extraction.npz").read_bytes())
    assert parameters_from_yaml(without).constants == {}
    made = export(tmp_path / "params.yaml", Target.camchain)
    assert made.notes == ("The stereo pair is as stated in the recording.",)
    intrinsics = yaml.safe_load(made.content)["cam0"]["intrinsics"]
    assert intrinsics[:2] == pytest.approx(np.diag(extraction.rig.cameras.each[0].K)[:2])
    urdf = {"urdf": params.with_name("robot.urdf"), "with_chain": True}
    for target, options in ((Target.camera_info_left, {}), (Target.urdf, urdf)):
        with pytest.raises(ConfigError, match="not estimated"):
            export(tmp_path / "params.yaml", target, **options)


@pytest.mark.parametrize(
    ("model", "D", "limit_px"),
    [
        ("none", [], 0.01),
        ("plumb_bob", [0.0] * 5, 0.01),
        ("plumb_bob", [-0.27, 0.09, 0.0005, -0.0004, 0.0], 0.2),
        ("rational_polynomial", [-0.3, 0.1, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0], 0.2),
        ("equidistant", [-0.02, 0.004, -0.002, 0.0005], 0.9),
    ],
)
@pytest.mark.parametrize("shares", [[0.0008, 0, 0, 0], [0.0008, -0.0006, 0.0004, -0.0008]])
def test_the_distortion_model_takes_over_the_correction(model, D, limit_px, shares):
    camera = Camera("c", 640, 480, K, np.array(D), model, LensCorrection(np.array(shares), CENTER))
    fitted, off_px = without_correction(camera)
    assert fitted.correction is None
    assert np.array_equal(fitted.K, K)
    assert fitted.distortion == ("plumb_bob" if model == "none" else model)
    rays, pixels = over_the_image(camera)
    off = np.linalg.norm(project(fitted, rays) - pixels, axis=1)
    assert off.max() <= off_px.max() * 1.05 < limit_px
    without = np.linalg.norm(project(replace(camera, correction=None), rays) - pixels, axis=1)
    assert np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(without**2))


MIMIC = b"""<robot name="r">
  <link name="base"/><link name="slide"/><link name="neck"/><link name="head"/><link name="optical"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="slide"/><origin xyz="0 0.1 0.5" rpy="0.1 0 0"/>
    <axis xyz="0 0 2"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
  <joint name="pan" type="revolute"><parent link="slide"/><child link="neck"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="half" type="revolute"><parent link="neck"/><child link="head"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 1 0"/><mimic joint="pan" multiplier="0.5" offset="0.1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="eye" type="fixed"><parent link="head"/><child link="optical"/></joint>
</robot>"""


def test_sliding_and_coupled_joints():
    """By hand: zeros move a sliding joint's origin along its axis, and a coupled joint's by its multiplier."""
    urdf = parse_urdf(MIMIC.decode())
    chain = HeadChain("base", "head", chain_links(urdf, "base", "head"), pan="pan")
    rig = replace(rig_of(ROBOTS["tick"]), chain=chain)
    names = [row.name for row in table(rig.cameras, chain) if row.kind.startswith("joint_")]
    values = dict(zip(names, np.linspace(-0.004, 0.005, len(names)), strict=True))
    improved = improved_chain(rig.chain, values)
    content = patched_urdf(MIMIC, robot(), {}, improved).content
    made = parse_urdf(content.decode())
    readings = np.array([[0.2, -0.7], [0.5, 0.4]])
    zeros = np.array([values[f"{name}_zero"] for name in ("lift", "pan")])
    for q, T in zip(readings, head_pose(improved.improved, readings + zeros), strict=True):
        by_hand = np.eye(4)
        for joint in made.path("base", "head"):
            read, multiplier, offset = joint.mimic or (joint.name, 1.0, 0.0)
            amount = multiplier * q[("lift", "pan").index(read)] + offset
            by_hand = by_hand @ joint.T_parent_child @ moved(joint, amount)
        assert by_hand == pytest.approx(T, abs=1e-9)
    assert b'<mimic joint="pan" multiplier="0.5" offset="0.1"/>' in content


def moved(joint, amount):
    if joint.kind == "prismatic":
        return se3.transform(np.eye(3), amount * joint.axis)
    return se3.transform(cv2.Rodrigues(amount * joint.axis)[0], np.zeros(3))
