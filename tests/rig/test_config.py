import re
from pathlib import Path

import pytest

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.files.reading import load_yaml
from mobilecal_cli.rig import config
from mobilecal_cli.rig.config import TODO, load_rig, parse_settings, setting_keys


@pytest.fixture
def write(tmp_path):
    def _write(text: str) -> Path:
        path = tmp_path / "rig.yaml"
        path.write_text(text)
        return path

    return _write


@pytest.mark.parametrize(
    "section", [s for s in config._Section.__subclasses__() if s.example], ids=lambda s: s.__name__
)
def test_the_example_of_a_section_is_valid(section):
    chain = section.example.replace("urdf: robot.urdf  # or the chain:", "")
    for example in (
        {section.example, chain} if section is not config.HeadConfig else {chain, "urdf: robot.urdf"}
    ):
        section.model_validate(load_yaml(example))


@pytest.mark.parametrize(
    "case",
    [
        ("bord: {columns: 9}", "bord: unknown key", "did you mean board?"),
        ("head_eye: {}\nprovenance: {}", "a params.yaml, the result of a calibration", "give the rig.yaml"),
        ("board: {column: 9, rows: 6}", "board.column: unknown key", "did you mean columns?"),
        ("wheels: {left: {ticks_per_rev: 3}}", "unknown key", "did you mean ticks_per_revolution?"),
        (
            "head: {chain: [{joint: a, axes: [0, 0, 1]}]}",
            "head.chain.0.axes: unknown key",
            "did you mean axis?",
        ),
        ("zzzzqq: 1", "zzzzqq: unknown key", "known keys: schema_version, board"),
        ("board: {columns: 9}", "give both columns and rows"),
        ("board: {columns: 2, rows: 6}", "find a checkerboard (got 2 x 6): use a larger one"),
        ("schema_version: 2", "schema_version"),
        ("cameras: {reference: middle}", "cameras.reference"),
        ("cameras: {joints: {image: /a}}", "cannot name a camera"),
        ("cameras: {front: {info: /a}}", "front has no image topic"),
        ("cameras: {front: {image: /a}, left: {image: /b}}", "give left and right (or both) for a"),
        ("wheels: {left: {joint: a, field: b, topic: c}}", "only one of joint, joints, field and fields"),
        ("wheels: {left: {field: data}}", "field requires topic"),
        ("wheels: {left: {topic: t, field: data, bits: 16}}", "bits requires ticks_per_revolution"),
        ("wheels: {left: {sign: 2}}", "wheels.left.sign"),
        ("head: {chain: [{joint: a, axis: [0, 0, 0]}]}", "axis has zero length"),
        ("head: {chain: [{joint: a}]}", "give both joint and axis"),
        ("head: {chain: [{joint: a, axis: [0, 0, 1], xyz_m: [0, 0, 0]}]}", "a link is either"),
        ("head: {urdf: a.urdf, chain: []}", "urdf or chain, not both"),
        (
            "nominal: {head_eye: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 2]}}",
            "has norm 2 (must be 1)",
        ),
        ("- a\n- b", "the top level is a list"),
        ("a: [", "not valid YAML", "mobilecal init"),
        ("board: 1\nboard: 2", "not valid YAML"),
        (
            "board: {kind: charuco, columns: 8, rows: 5, marker_share: 0.7}",
            "a board of kind charuco requires dictionary",
        ),
        ("board: {kind: aprilgrid, columns: 6, rows: 6}", "a board of kind aprilgrid requires gap_share"),
        ("board: {kind: aprilgrid}", "requires columns, rows, gap_share"),
        ("board: {columns: 8, rows: 5, marker_share: 0.7}", "set kind to charuco or aprilgrid"),
        (
            "board: {kind: charuco, columns: 8, rows: 5, dictionary: DICT_9X9, marker_share: 0.7}",
            "board.dictionary: not a marker dictionary of OpenCV, such as DICT_",
        ),
        (
            "joints: {fields: {pan: {topics: /head, field: angle}}}",
            "joints.fields.pan.topics: unknown key",
            "did you mean topic",
        ),
        ("board: {square_m: .inf}", "board.square_m: must be from 0.0001 to 10 m (got inf)"),
        ("board: {square_m: true}", "board.square_m: must be a valid number (got True)"),
        ("wheels: {left: {topics: /a}}", "wheels.left.topics: must be a list (got '/a')"),
        (
            "nominal: {head_eye: {translation_m: [0,1, 0,2]}}",
            "translation_m: must have at most 3 items, not 4",
        ),
        ("cameras: {rectified: maybe}", "cameras.rectified: must be true or false (got 'maybe')"),
        ("board: {square_m: 0,08}", "board.8: not a key (got 8); write numbers with a decimal point"),
        ("board:\n  square_m: 0,08", "(got '0,08'); write numbers with a decimal point"),
        ("gates: {stations: 10,5}", "must be a valid string (got 5); write numbers with a decimal point"),
        ("gates: {stations: true}", "gates.stations: must be a valid number (got True)"),
        ("board: {square_m: '0.1'}", "board.square_m: must be a valid number (got '0.1')"),
        (
            "nominal: {head_eye: {translation_m: [30, 60, 40], quaternion_xyzw: [0, 0, 0, 1]}}",
            "nominal.head_eye.translation_m.0: must be from -20 to 20 m; 30 looks like millimeters: 0.03 m",
        ),
        (
            "head: {chain: [{xyz_m: [0, 0, 0], rpy_rad: [0, 0, 90]}]}",
            "rpy_rad.2: must be from -6.28319 to 6.28319 rad; 90 looks like degrees: 1.571 rad",
        ),
        (
            "priors: fixed",
            "priors: a section of keys, not a value (got 'fixed')",
            "write priors: {all: fixed}",
        ),
        ("board: 9x6", "board: a section of keys", "write board: {kind: VALUE}; keys: kind, columns, rows"),
        ("cameras: {left: 5}", "cameras.left: a section of keys", "write left: {image: VALUE}; keys: image"),
        ("priors:", "priors: a section of keys, not a value (got None)", "write priors: {NAME: VALUE}"),
    ],
)
def test_bad_files(write, case):
    text, message, *hints = case
    path = write(text)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    assert str(path) in caught.value.message
    assert message in caught.value.message
    assert all(hint in caught.value.hint for hint in hints)


def test_what_a_draft_leaves_to_the_user_is_refused():
    for key, _ in setting_keys():
        with pytest.raises(ConfigError, match=f"not filled in yet: {key}"):
            load_rig(None, {key: TODO})


@pytest.mark.parametrize("value", [float("nan"), 1e300])
def test_no_setting_takes_an_impossible_number(value):
    for key, _ in setting_keys():
        with pytest.raises(ConfigError, match=re.escape(key.partition(".")[0])):
            load_rig(None, {key: value})


@pytest.mark.parametrize(
    ("key", "value", "hint"), [("board", "9x6", "board.kind=VALUE;"), ("priors", "free", "priors.all=free")]
)
def test_a_section_as_an_option_is_written_as_one(key, value, hint):
    with pytest.raises(ConfigError, match=f"{key}: a section of keys, not a value") as caught:
        load_rig(None, {key: value})
    assert caught.value.hint.startswith(f"write {hint}")


def test_settings_are_yaml():
    assert parse_settings(["wheels.left.sign=-1"]) == {"wheels.left.sign": -1}
    assert parse_settings(["cameras.rectified=true"]) == {"cameras.rectified": True}
    assert parse_settings(["head.base_frame=base=x"]) == {"head.base_frame": "base=x"}
    gate = parse_settings(["gates.std.wheels.separation_m=0.002"])  # dots in its name
    assert load_rig(None, gate).gates == {"std.wheels.separation_m": 0.002}


@pytest.mark.parametrize(
    "bad", ["novalue", "=3", "a=[1", "board.columns=", "board.columns= ", "board.columns=null"]
)
def test_a_setting_without_a_value_is_no_default(bad):
    """An empty value silently meant the default."""
    with pytest.raises(ConfigError, match=re.escape(f"--set {bad}: ")):
        parse_settings([bad])


@pytest.mark.parametrize("value", ["-0.1", ".nan", ".inf", "exact", "true", "[1]", "null"])
def test_other_priors_are_refused(write, value):
    with pytest.raises(ConfigError) as caught:
        load_rig(write(f"priors: {{focal_length: {value}}}"))
    said = "priors.focal_length: must be a standard deviation (0, or from 1e-09 to 10000), fixed or free"
    assert said in caught.value.message
