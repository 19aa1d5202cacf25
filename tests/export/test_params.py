import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.export.text import decimal, dump, quoted
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.findings import EstimatedConstant
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import JointLink
from tests.formats import small_uncertainty
from tests.report.example import HOSTILE, make_extraction, make_hostile, make_solution, params_of

GOLDEN = Path(__file__).parent / "golden"
# What PyYAML takes for a float (its resolver's pattern, YAML 1.1): the exponent needs a point and a sign.
PYYAML_FLOAT = re.compile(
    r"[-+]?([0-9][0-9_]*)\.[0-9_]*([eE][-+][0-9]+)?|\.[0-9][0-9_]*([eE][-+][0-9]+)?|[-+]?\.(inf|nan)"
)


def load(text: str, version: str = "1.2"):
    yaml = YAML(typ="safe", pure=True)
    yaml.version = version
    return yaml.load(text)


def both_versions(text: str):
    old, new = load(text, "1.1"), load(text)
    assert old == new
    return new


@pytest.fixture(scope="module")
def extraction():
    return make_extraction()


@pytest.fixture(scope="module")
def solution(extraction):
    return make_solution(extraction)


def rounded(text):
    """A text with five digits of each number: further ones differ between versions of the linear algebra."""
    return re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda number: f"{float(number[0]):.5g}", text)


def test_the_whole_file_against_its_golden_copy(extraction, solution):
    text = params_of(solution, extraction)
    assert rounded(text) == (GOLDEN / "params.yaml").read_text(encoding="utf-8")
    quality = both_versions(text)["quality"]
    assert quality["point_rms_mm"] == pytest.approx(solution.point_rms_m * 1000, rel=1e-12)
    assert quality["reprojection_rms_px"] == pytest.approx(solution.reprojection_rms_px, rel=1e-12)


def test_every_number_is_a_float_for_pyyaml_too(extraction, solution):
    T = se3.transform(np.eye(3), np.array([1e-5, -2e-9, -0.0]))
    tiny = dataclasses.replace(solution, parameters=Parameters(T, solution.parameters.wheels))
    text = params_of(tiny, extraction)
    lists = re.findall(r"(?:translation_m|quaternion_xyzw): \[(.*)\]", text)
    numbers = [number for group in lists for number in group.split(", ")]
    assert len(numbers) == 7
    assert all(PYYAML_FLOAT.fullmatch(number) for number in numbers)
    assert numbers[:3] == ["0.00001", "-0.000000002", "0.0"]


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_decimals_come_back(value):
    text = decimal(value)
    assert PYYAML_FLOAT.fullmatch(text)
    assert "e" not in text.lower()
    assert not text.startswith("-0.0") or float(text) < 0
    assert float(text) == pytest.approx(value, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_decimal_is_finite(value):
    with pytest.raises(ValueError, match="cannot be written"):
        decimal(value)


@given(st.text(st.characters()))
def test_any_string_comes_back_from_one_quoted_line(text):
    line = quoted(text)
    assert len(line.splitlines()) == 1
    assert both_versions(f"key: {line}  # comment\n") == {"key": text}


@pytest.mark.parametrize(
    "word", ["yes", "No", "null", "~", "1e-5", "2024-01-01", "12:30:45", "0o7", "=", "<<"]
)
def test_strings_and_keys_that_look_like_values_stay_strings(word):
    data = {word: word, "in": [word, {"x": word}]}
    assert both_versions(dump(data)) == data


def test_head_eye_speaks_of_the_reference_camera(extraction, solution):
    stereo = dataclasses.replace(extraction.rig.cameras, reference="right")
    right = dataclasses.replace(extraction, rig=dataclasses.replace(extraction.rig, cameras=stereo))
    solution = dataclasses.replace(solution, cameras=stereo)
    robot = parameters_from_yaml(params_of(solution, right))
    assert robot.child_frame == "stereo_right_optical"
    expected = solution.parameters.T_h_c @ stereo.T_c_each[1]
    np.testing.assert_allclose(robot.T_parent_child, expected, rtol=0, atol=1e-12)


def test_rectified_pictures_name_both_frames():
    extraction = make_extraction()
    R = se3.exp_so3(np.array([0.01, -0.02, 0.005]))
    cameras = dataclasses.replace(extraction.rig.cameras, rectified=True, R_rect=(R, R))
    extraction = dataclasses.replace(extraction, rig=dataclasses.replace(extraction.rig, cameras=cameras))
    solution = dataclasses.replace(make_solution(make_extraction()), cameras=cameras)
    data = both_versions(params_of(solution, extraction))
    assert data["head_eye"]["child_frame"] == "stereo_left_optical"
    raw = data["head_eye_raw"]
    assert raw["child_frame"] == "stereo_left_optical_raw"
    assert raw["translation_m"] == data["head_eye"]["translation_m"]
    R_h_rect = se3.from_quaternion_xyzw(np.array(data["head_eye"]["quaternion_xyzw"]))
    R_h_raw = se3.from_quaternion_xyzw(np.array(raw["quaternion_xyzw"]))
    ray_raw = np.array([0.1, -0.2, 1.0])  # the same ray in both frames is the same ray in the head
    ray_rect = extraction.rig.cameras.R_rect[0] @ ray_raw
    np.testing.assert_allclose(R_h_raw @ ray_raw, R_h_rect @ ray_rect, atol=1e-11)


def test_a_note_near_gimbal_lock_only(extraction, solution):
    text = params_of(solution, extraction)
    assert "gimbal" not in text
    T = se3.transform(se3.from_rpy(np.radians([-164.22, 89.38, -166.4])), np.zeros(3))
    locked = Parameters(T, solution.parameters.wheels)
    text = params_of(dataclasses.replace(solution, parameters=locked), extraction)
    assert "# y is 0.6 degrees from gimbal lock" in text
    head_eye = both_versions(text)["head_eye"]
    assert head_eye["euler_zyx_deg"] is None
    np.testing.assert_allclose(
        se3.from_quaternion_xyzw(np.array(head_eye["quaternion_xyzw"])), locked.T_h_c[:3, :3], atol=1e-11
    )
    assert parameters_from_yaml(text).parent_frame == "head_link"


def test_strings_from_the_log_cannot_break_the_file(extraction, solution):
    hostile = make_hostile(extraction)
    named = {"logs": (LogSource(HOSTILE, "0" * 64),), "config": {HOSTILE: [HOSTILE]}}
    data = both_versions(params_of(solution, hostile, **named))
    assert data["head_eye"]["parent_frame"] == HOSTILE
    assert data["provenance"]["logs"][0]["path"] == HOSTILE
    assert data["provenance"]["config"] == {HOSTILE: [HOSTILE]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("schema_version: 3", "schema_version: 5"), "schema_version: must be 3 or 4 (got 5)"),
        (("  radius_left_m:", "  radius_lft_m:"), "wheels.radius_left_m: missing"),
        (("  separation_m: 0", "  separation_m: -0"), "separation_m: must be from 0.01 to 100 m (got -0."),
        (("  radius_left_m: 0", "  radius_left_m: true #"), "valid number (got True)"),
        (("  radius_left_m: 0", "  radius_left_m: '0.1' #"), "valid number (got '0.1')"),
        (("  radius_left_m: 0", "  radius_left_m: 1e-300 #"), "must be from 0.001 to 10 m (got 1e-300)"),
        (("  radius_left_m: 0", "  radius_left_m: 81 #"), "0.001 to 10 m; 81 looks like millimeters"),
        (("translation_m: [", "translation_m: [1e200, 0, 0] #"), "must be from -20 to 20 m (got 1e+200)"),
        (('{"x": -87.', '{"x": -79.'), "euler_zyx_deg and quaternion_xyzw are 8 degrees apart"),
        (("translation_m: [", "translation_m: [.nan, "), "head_eye.translation_m"),
        (("quaternion_xyzw: [-0.4", "quaternion_xyzw: [-2.4"), "quaternion_xyzw has norm 2.64"),
        (("head_eye:", "head_eye: ["), "not valid YAML"),
        (("head_eye:", "head_ey:"), "head_eye: missing"),
    ],
)
def test_a_bad_file_is_a_config_error(extraction, solution, change, said):
    text = params_of(solution, extraction)
    assert change[0] in text
    with pytest.raises(ConfigError, match=r"^calib\.yaml: ") as caught:
        parameters_from_yaml(text.replace(*change), "calib.yaml")
    assert said in caught.value.message
    assert caught.value.hint


CONSTANTS = {
    constant.name: constant
    for constant in (
        EstimatedConstant("focal_left", "focal_length", "left camera", "focal length", 1.25e-3, 4e-4, 2e-3),
        EstimatedConstant("pan_zero", "joint_zero", "head_pan", "zero position", -2e-3, 1e-3, 9e-3),
        EstimatedConstant("lift # 1_zero", "joint_zero", "lift # 1", "zero position", 1e-4, 1e-5, 9e-4),
        EstimatedConstant("board_bend_x", "board_bend", "board", "bend along x", 3e-4, 0.0, 0.0),
        EstimatedConstant("baseline_scale", "baseline_length", "stereo pair", "length", 0.0, 0.0, 0.0),
    )
}


def with_constants(solution, extraction):
    """A solution with constants: one of a sliding joint with a strange name, and two that the user fixed."""
    lift = JointLink("lift # 1", np.array([0.0, 0, 1]), "prismatic")
    chain = dataclasses.replace(extraction.rig.chain, links=(lift, *extraction.rig.chain.links))
    rig = dataclasses.replace(extraction.rig, chain=chain)
    found = dataclasses.replace(solution, uncertainty=small_uncertainty(), constants=CONSTANTS)
    return found, dataclasses.replace(extraction, rig=rig)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("focal_left", "focal_lef"), ("board_bend_x", "board_bnd_x")],
)
def test_a_constant_of_an_unknown_name(extraction, solution, right, wrong):
    """It was ignored."""
    text = params_of(*with_constants(solution, extraction)).replace(f"{right}:", f"{wrong}:")
    with pytest.raises(ConfigError, match=rf"constants\.{wrong}: unknown constant") as caught:
        parameters_from_yaml(text)
    assert caught.value.hint == f"did you mean {right}?"


def test_constants_are_listed_with_their_units(extraction, solution):
    found, lifted = with_constants(solution, extraction)
    text = params_of(found, lifted)
    constants = both_versions(text)["constants"]
    assert list(constants) == ["focal_left", "pan_zero", "lift # 1_zero", "board_bend_x"]
    assert constants["focal_left"] == {"value": 1.25e-3, "sigma": 4e-4, "prior": 2e-3, "unit": "share"}
    assert [entry["unit"] for entry in constants.values()] == ["share", "rad", "m", "m"]
    assert constants["board_bend_x"] == {"value": 3e-4, "sigma": 0, "prior": 0, "unit": "m"}
    robot = parameters_from_yaml(text)
    assert robot.constants == {name: CONSTANTS[name].value for name in constants}
    numbers = re.findall(r"(?:value|sigma|prior): ([^,]*),", text)
    assert len(numbers) == 12
    assert all(PYYAML_FLOAT.fullmatch(number) for number in numbers)
    text = params_of(dataclasses.replace(found, constants={}), lifted)
    assert parameters_from_yaml(text).constants == {}


def test_the_verdict_has_any_sentence_as_its_reason(extraction, solution):
    text = params_of(solution, extraction, "FAIL", ["a: 'b' # \u00b0", "line\nline"])
    assert both_versions(text)["verdict"]["level"] == "FAIL"
    robot = parameters_from_yaml(text)
    assert (robot.verdict, robot.reasons[0]) == ("FAIL", "a: 'b' # \u00b0")
    assert "\n" not in robot.reasons[1]


def test_an_uncertainty_that_contradicts_itself_is_refused(extraction, solution):
    found, lifted = with_constants(solution, extraction)
    text = params_of(found, lifted)
    assert parameters_from_yaml(text).knowledge is not None
    with pytest.raises(ConfigError, match=r"std.r_x is 0.01, but the covariance gives 0.001"):
        parameters_from_yaml(text.replace("std: {r_x: 1.0", "std: {r_x: 1.0e-02, unused: 1.0", 1))
    data = YAML(typ="safe").load(text)
    data["uncertainty"]["covariance"][0][1] = data["uncertainty"]["covariance"][1][0] = 2e-6
    with pytest.raises(ConfigError, match="not positive semidefinite"):
        parameters_from_yaml(json.dumps(data))
