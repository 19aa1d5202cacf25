"""Recordings of one camera and of three, from the file to the verdict; and what is refused."""

import re

import numpy as np
import pytest
import yaml

from mobilecal_cli import se3
from mobilecal_cli.calibrate.export import export
from mobilecal_cli.calibrate.steps import Report, calibrate, extract, solve
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.record import published, simulate, write
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.simulate.scenario import Scenario, World
from tests.command import run, succeeded
from tests.export.test_improved import fitted_cameras
from tests.robots import three_on_pan_tilt
from tests.truth import nees

SQUARE = {"board.square_m": 0.08}
SQUARES = load_rig(None, SQUARE)


ALL_BUT_THE_HEIGHT = np.arange(9) != 5


def true_to(found, robot, kept=slice(None)):
    return nees(found.parameters, found.covariance, robot, kept)


@pytest.fixture(scope="module")
def rgbd(tmp_path_factory):
    path = tmp_path_factory.mktemp("rgbd") / "log.bag"
    simulate(Scenario(robot="rgbd", container="bag", seed=4, pictures_per_rest=1), path)
    return path


@pytest.fixture(scope="module")
def calibrated(rgbd, tmp_path_factory):
    """The report on it, and the directory of its files."""
    directory = tmp_path_factory.mktemp("rgbd") / "result"
    return calibrate([rgbd], directory, config=SQUARES), directory


def test_one_camera_on_the_base_passes_with_true_sigmas(rgbd, calibrated, tmp_path):
    robot, (report, written) = ROBOTS["rgbd"], calibrated
    assert report.verdict.level == "PASS"
    assert true_to(report.fit, robot, ALL_BUT_THE_HEIGHT) < 2.7
    params = yaml.safe_load((written / "params.yaml").read_text(encoding="utf-8"))
    assert params["head_eye"]["child_frame"] == "camera_color_optical_frame"
    assert params["head_eye"]["parent_frame"] == "base_link"
    for target in ("camera_info", "foxglove", "json", "static_transform_yaml"):
        succeeded("export", written / "params.yaml", "--to", target, "--output", tmp_path / target)
    left = ("--to", "camera_info_left", "--output", tmp_path / "left")
    refused = run("export", written / "params.yaml", *left)
    assert (refused.code, "no camera 'left'" in refused.err) == (2, True)
    succeeded("calibrate", written / "extraction.npz", "--output", tmp_path / "again")
    # The height of the camera, which no motion shows, is not compared.
    judged = run("evaluate", rgbd, written / "params.yaml", "--set", "board.square_m=0.08")
    assert (judged.code, "camera position" in judged.out) == (0, True)


NEGATED = ("wheels.left.sign=-1", "wheels.right.sign=-1")
EXCHANGED = ("wheels.left.joint=wheel_right_joint", "wheels.right.joint=wheel_left_joint")


@pytest.mark.parametrize(
    ("settings", "cause"),
    [
        pytest.param(
            NEGATED[:1], "description: the left wheel's encoder has the wrong sign", marks=pytest.mark.long
        ),
        (NEGATED, "description: the encoders of both wheels have the wrong sign, or the nominal pose"),
        pytest.param(
            EXCHANGED,
            "description: the left and right wheels are swapped, or the nominal pose",
            marks=pytest.mark.long,
        ),
        (EXCHANGED + NEGATED, "wheels are swapped and the encoders of both wheels have the wrong sign, or"),
    ],
)
def test_wheels_of_a_camera_on_the_base_that_are_not_as_stated(rgbd, calibrated, tmp_path, settings, cause):
    flags = [word for setting in settings for word in ("--set", setting)]
    # Signs are also those of an extraction, which needs no images.
    source = (rgbd, "--square-m", "0.08") if settings[0] in EXCHANGED else (calibrated[1] / "extraction.npz",)
    done = run("calibrate", *source, *flags, "--output", tmp_path / "result")
    assert done.code in (5, 6)
    assert cause in " ".join((done.out + done.err).split())


def test_one_camera_needs_the_squares(rgbd, tmp_path):
    done = run("calibrate", rgbd)
    assert done.code == 2
    assert "does not show the size of the board's squares" in " ".join(done.err.split())
    assert "board: {square_m: 0.08}" in " ".join(done.err.split())
    looked = succeeded("inspect", rgbd, "--set", "board.square_m=0.08")
    assert "left" not in re.sub("left wheel_left|left wheel|wheel_left|rotation: left", "", looked.out)
    assert "camera fixed to base_link" in looked.out
    assert "tilt the head" not in looked.out
    (tmp_path / "rig.yaml").write_text("board: {square_m: 0.08}", encoding="utf-8")
    checked = succeeded("check", tmp_path / "rig.yaml", rgbd)
    assert "all parameters but the camera's height" in " ".join(checked.out.split())


#: How far a camera is from where it is drawn: 1 degree and 5 mm, more than the disparity of two cameras shows.
_OFF = se3.exp(np.array([0.01, -0.012, 0.008, 0.003, -0.004, 0.002]))


@pytest.mark.long
def test_three_cameras_from_a_recording(tmp_path):
    robot = three_on_pan_tilt()
    scenario = Scenario(stations=10, seed=6, pictures="png")
    route = plan_route(robot, stations=scenario.stations, board=scenario.board, seed=scenario.seed)
    path = tmp_path / "three.mcap"
    messages = published(World(scenario, robot, route), lambda done, total: None)
    write("mcap", path, messages)
    settings = {**SQUARE, "board.columns": 9, "board.rows": 6}
    for side in ("left", "right"):
        wheel = {"topic": f"/wheel_ticks/{side}", "field": "data", "ticks_per_revolution": 4096, "bits": 16}
        settings[f"wheels.{side}"] = wheel
    for name, T in robot.mounted.items():
        settings[f"cameras.{name}.image"] = f"/{name}/image_raw/compressed"
        if name != "front":
            drawn = T @ _OFF
            quaternion = se3.quaternion_xyzw(drawn[:3, :3]).tolist()
            pose = {"translation_m": drawn[:3, 3].tolist(), "quaternion_xyzw": quaternion}
            settings[f"cameras.{name}.pose"] = pose
    data = extract([path], settings=settings)
    extraction = data.extraction
    assert extraction.rig.cameras.names == ("front", "beside", "aside")
    shown = np.array([[view.pictures > 0 for view in o.views] for o in extraction.observations])
    assert len(shown) >= 8
    assert shown.any(axis=0).all()
    assert not shown.all()
    report = Report(data, solve(data))
    assert true_to(report.fit, robot) < 2.7
    fitted = fitted_cameras(extraction, report.fit.solution)
    for k, name in enumerate(robot.mounted):
        info = yaml.safe_load(export(report, "camera_info", camera=name).content)
        np.testing.assert_allclose(info["camera_matrix"]["data"], fitted.each[k].K.ravel(), rtol=1e-9)
        np.testing.assert_allclose(info["projection_matrix"]["data"][:3], fitted.each[k].K[0], rtol=1e-9)
    with pytest.raises(ConfigError, match="no camera 'left'"):
        export(report, "camera_info", camera="left")
    with pytest.raises(ConfigError, match="--camera applies only to --to camera_info"):
        export(report, "camera_info_left", camera="left")
    chain = yaml.safe_load(export(report, "camchain").content)
    T = np.eye(4)
    for k, name in enumerate(robot.mounted):
        T = np.array(chain[f"cam{k}"].get("T_cn_cnm1", np.eye(4))) @ T
        np.testing.assert_allclose(np.linalg.inv(T), fitted.T_c_each[k], atol=1e-8)
        assert chain[f"cam{k}"]["rostopic"] == f"/{name}/image_raw/compressed"
