"""Settings have the same ranges wherever they come from: rig.yaml, params.yaml or extraction.npz."""

import io
import json
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli.calibrate.evaluate import evaluate
from mobilecal_cli.calibrate.export import export
from mobilecal_cli.calibrate.load import read_extraction, read_params
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml
from mobilecal_cli.model.rig import Board, Markers, Nominal, WheelGeometry
from mobilecal_cli.model.solution import Provenance
from mobilecal_cli.rig.config import checked_settings
from mobilecal_cli.rig.settings import settings_of
from mobilecal_cli.simulate.robot import ROBOTS
from tests.extractions import Noise, simulated
from tests.report.example import make_extraction, make_solution


def noise(**levels):
    return lambda e: replace(e, rig=replace(e.rig, noise=levels))


def prior(sigma):
    return lambda e: replace(e, rig=replace(e.rig, prior_sigmas={"focal_left": sigma}))


def nominal(*sizes, T=None):
    wheels = WheelGeometry(*sizes) if sizes else None
    return lambda e: replace(e, rig=replace(e.rig, nominal=Nominal(T, wheels)))


def far(meters):
    T = np.eye(4)
    T[0, 3] = meters
    return T


def ticks(count):
    def changed(e):
        left, right = (
            replace(e.rig.sources.wheels[side], ticks_per_revolution=count) for side in ("left", "right")
        )
        wheels = {"left": left, "right": right}
        return replace(e, rig=replace(e.rig, sources=replace(e.rig.sources, wheels=wheels)))

    return changed


#: Key of rig.yaml → an extraction with an impossible value, and what the message says.
CASES = {
    "pixel": (noise(pixel_px=-1.0), "noise.pixel_px: must be from 1e-09 to 10000"),
    "joint nan": (noise(joint_rad=float("nan")), "noise.joint_rad: must be from 1e-09 to 10000"),
    "prior": (prior(-1.0), "priors.focal_left: must be a standard deviation"),
    "prior negative infinity": (prior(-np.inf), "priors.focal_left: must be a standard deviation"),
    "radius": (nominal(-1.0, 0.1, 0.4), "nominal.wheels.radius_right_m: must be from 0.001 to 10 m"),
    "separation": (nominal(0.1, 0.1, 0.0), "nominal.wheels.separation_m: must be from 0.01 to 100 m"),
    "position": (nominal(T=far(300.0)), "nominal.head_eye.translation_m.0: must be from -20 to 20 m"),
    "square": (lambda e: replace(e, board=replace(e.board, square_m=-0.1)), "board.square_m: must be from"),
    "corners": (lambda e: replace(e, board=replace(e.board, columns=0)), "board.columns: must be"),
    "ticks": (ticks(0.5), "wheels.left.ticks_per_revolution: must be from 1 to"),
}


@pytest.fixture(scope="module")
def params():
    extraction = make_extraction()
    provenance = Provenance("0.1.0", "", "lm", extraction.logs, settings_of(extraction))
    return YAML(typ="safe").load(params_yaml(make_solution(extraction), extraction, provenance))


def as_yaml(data):
    stream = io.StringIO()
    YAML(typ="safe").dump(data, stream)
    return stream.getvalue()


@pytest.mark.parametrize(("change", "said"), CASES.values(), ids=CASES)
def test_ranges(change, said):
    with pytest.raises(ConfigError) as caught:
        checked_settings(settings_of(change(make_extraction())), "file: ")
    assert f"file: {said}" in caught.value.message


@pytest.mark.parametrize("name", ["joint nan", "prior negative infinity"])
def test_every_reader_checks_an_extraction(tmp_path, params, name):
    change, said = CASES[name]
    path = tmp_path / "extraction.npz"
    path.write_bytes(extraction_to_npz_with_nan(change(make_extraction())))
    (tmp_path / "params.yaml").write_text(as_yaml(params))
    for read in (
        read_extraction,
        lambda path: evaluate([path], tmp_path / "params.yaml"),
        lambda path: export(tmp_path / "params.yaml", "camchain"),
    ):
        with pytest.raises(RecordingError) as caught:
            read(path)
        assert f"{path}: damaged: {said}" in caught.value.message
        assert caught.value.hint


def test_every_reader_checks_params_yaml(tmp_path, params):
    change, said = CASES["joint nan"]
    damaged = params | {"provenance": {"config": settings_of(change(make_extraction()))}}
    path = tmp_path / "params.yaml"
    path.write_text(as_yaml(damaged))
    (tmp_path / "extraction.npz").write_bytes(extraction_to_npz(make_extraction()))
    for read in (
        lambda path: evaluate([tmp_path / "extraction.npz"], path),
        lambda path: export(path, "odometry_covariance"),
        read_params,
    ):
        with pytest.raises(ConfigError) as caught:
            read(path)
        assert f"{path}: provenance.config: {said}" in caught.value.message


def extraction_to_npz_with_nan(extraction):
    """The writer refuses NaN; JSON's reader takes it."""
    dumps = json.dumps
    with patch("json.dumps", lambda *given, **named: dumps(*given, **(named | {"allow_nan": True}))):
        return extraction_to_npz(extraction)


@pytest.mark.parametrize(
    ("level", "said"),
    [
        (-1.0, "from 0 to 1000"),
        (1e9, "from 0 to 1000"),
        (float("nan"), "a finite number"),
        *((value, "a valid number") for value in ("wide", True, None)),
    ],
)
def test_estimated_noise_levels(params, level, said):
    order = ["r_x", "r_y", "r_z", "t_x", "t_y", "t_z", "radius_right", "radius_left", "separation"]
    known = {
        "order": order,
        "covariance": (np.eye(9) * 1e-6).tolist(),
        "observable": dict.fromkeys(order, True),
        "noise": {"pixel_px": 0.1, "stamp_s": 0, "estimated": ["pixel_px"]},
    }
    assert parameters_from_yaml(as_yaml(params | {"uncertainty": known})).knowledge.noise["stamp_s"] == 0
    known["noise"]["pixel_px"] = level
    with pytest.raises(ConfigError, match=rf"uncertainty\.noise\.pixel_px: must be {said}"):
        parameters_from_yaml(as_yaml(params | {"uncertainty": known}))


def test_a_measured_square_is_no_setting(tmp_path):
    """A baseline in millimeters makes squares of 80 m: a wrong result, which can still be read."""
    extraction = make_extraction()
    board = replace(extraction.board, square_m=None)
    seen = tuple(replace(o, square_m=80.0) for o in extraction.observations)
    path = tmp_path / "extraction.npz"
    path.write_bytes(extraction_to_npz(replace(extraction, board=board, observations=seen)))
    assert read_extraction(path).board.square_m is None


@pytest.mark.parametrize(
    "board",
    [
        Board(9, 6, 0.08),
        Board(9, 6),
        Board(8, 5, 0.08, Markers("charuco", "DICT_5X5_100", 0.75)),
        Board(6, 6, 0.08, Markers("aprilgrid", "DICT_APRILTAG_36h11", 0.3, 10, 2)),
    ],
)
@pytest.mark.parametrize("sigma", [0.0, 1e-4, np.inf])
def test_every_board_and_prior_passes(board, sigma):
    extraction = prior(sigma)(replace(make_extraction(), board=board))
    checked = checked_settings(settings_of(extraction), "")
    assert checked.board.columns == board.columns
    assert checked.priors["focal_left"] in ("fixed", "free", pytest.approx(0.01))


def test_every_simulated_robot_passes(tmp_path):
    for name, robot in ROBOTS.items():
        extraction = simulated(noise=Noise(pixel_px=0.1), robot=name, stations=4, seed=0)
        path = tmp_path / f"{name}.npz"
        path.write_bytes(extraction_to_npz(replace(extraction, logs=make_extraction().logs)))
        assert read_extraction(path).rig.chain.joints == robot.joint_names
