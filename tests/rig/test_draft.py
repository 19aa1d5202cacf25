"""`draft_rig`: what is filled in, from where, and what is left to the user."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli import se3
from mobilecal_cli.files.reading import load_yaml
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model.signals import BoardView, NumberField, TopicInfo
from mobilecal_cli.ranges import ACCURACY
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.draft import draft_rig
from mobilecal_cli.rig.names import may_be_a_reading
from mobilecal_cli.rig.resolve import survey_rig
from tests.rig.test_resolve import AT_BASE, HEAD_ONLY, TF, URDF, WITH_CAMERA, description, resolve_rig


def drafted(log, name="log", **given):
    return draft_rig(survey_rig(RigConfig(), log), name, **given)


def loaded(draft):
    return RigConfig.model_validate(YAML(typ="safe").load(draft.text))


def keys(draft):
    return {one.key: one.value for one in draft.filled}


def todo(draft, needed=True):
    return {one.key: one.why for one in draft.todo if one.needed == needed}


def board(seen=12, squares_m=(0.0799, 0.08, 0.0801), **changes):
    values = {"pictures": 12, "seen": seen, "size": (9, 6), "squares_m": squares_m}
    return BoardView(**(values | changes))


def test_a_draft_loads_and_settles_the_same_rig():
    log = description(urdf=WITH_CAMERA)
    draft = drafted(log, "some log.mcap", board=board())
    again, first = (resolve_rig(config, log)[0] for config in (loaded(draft), RigConfig()))
    assert again.sources == first.sources
    assert again.chain.joints == first.chain.joints
    assert again.nominal.wheels == first.nominal.wheels
    np.testing.assert_allclose(again.nominal.T_h_reference, first.nominal.T_h_reference, atol=1e-9)
    size = loaded(draft).board
    assert (size.columns, size.rows, size.square_m) == (9, 6, None)
    assert todo(draft) == {}
    assert set(todo(draft, needed=False)) == {"board.square_m"}
    assert all(f"#   {name}: {limit:g}\n" in draft.text for name, limit in ACCURACY.items())
    # Each value stands beside its source.
    for one in draft.filled:
        assert one.source in draft.text
        assert one.key.rsplit(".", 1)[-1] in draft.text


def test_a_draft_of_a_poor_log_asks_with_templates_that_can_be_uncommented():
    images = ("/camera/image: #odd\n", "/other/image")
    draft = drafted(description(images=images, urdf=None, joint_names={}))
    assert set(todo(draft)) == {"cameras", "wheels", "head"}
    assert "# TODO cameras: several cameras" in draft.text
    assert draft.filled == []
    loaded(draft)
    for name in ("cameras", "wheels", "nominal"):
        block = draft.text[draft.text.index(f"\n# {name}:\n") + 1 :].split("\n\n")[0]
        lines = [line for line in block.splitlines() if re.match(rf"# (  |{name}:)", line)]
        assert lines.count(f"# {name}:") == 1
        text = "\n".join(line[2:] for line in lines)
        assert set(YAML(typ="safe").load(text)) == {name}, text
        assert len(lines) >= 3


@pytest.mark.parametrize(
    ("topics", "names"),
    [
        (("/front/image_raw", "/rear/image_raw", "/mast/image_raw"), ("front", "rear", "mast")),
        (("/cam_left/image", "/cam_top/image"), ("left_camera", "top")),
        (("/camera/image_raw", "/camera/top/image_raw"), ("camera_1", "top")),
        (("/a: b/image", "/c/image"), ("a_b", "c")),
    ],
)
def test_every_camera_of_several_is_in_the_draft(topics, names):
    draft = drafted(description(images=topics, urdf=None, joint_names={}))
    block = draft.text[draft.text.index("\n# cameras:\n") + 1 :].split("\n\n")[0]
    uncommented = "\n".join(line.removeprefix("# ") for line in block.splitlines())
    cameras = RigConfig.model_validate(YAML(typ="safe").load(uncommented)).cameras
    assert {name: each.image for name, each in cameras.each.items()} == dict(zip(names, topics, strict=True))


def test_the_joint_positions_are_those_of_the_urdf():
    """The chain that is listed as a comment is the chain of the URDF."""
    urdf = URDF.format(x=-0.2)
    draft = drafted(description(urdf=urdf))
    links = [line.strip(" #-") for line in draft.text.splitlines() if line.startswith("  #   - ")]
    chain = [YAML(typ="safe").load(link) for link in links]
    given = RigConfig.model_validate(
        {"head": {"chain": chain}, "joints": {"pan": "head_pan_joint", "tilt": "head_tilt_joint"}}
    )
    ours, theirs = (resolve_rig(config, description(urdf=urdf))[0].chain for config in (given, RigConfig()))
    angles = np.array([[0.3, -0.2], [-1.0, 0.4]])
    np.testing.assert_allclose(head_pose(ours, angles), head_pose(theirs, angles), atol=1e-9)
    assert "not midway between the wheels" in draft.notes[0]


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (board(seen=2), "2 of 12 images show a whole board of 9 x 6;"),
        (board(other_sizes=1), "show a whole board of 9 x 6, 1 a board of another size;"),
        (board(seen=0, size=None, squares_m=()), "0 of 12 images show a whole checkerboard"),
    ],
)
def test_a_board_that_is_not_certain_is_asked_for(seen, words):
    draft = drafted(description(), board=seen)
    asked = todo(draft, needed=seen.size is None)
    assert words in asked["board"]
    assert loaded(draft).board.columns is None


@pytest.mark.parametrize(
    ("measured_m", "likely_m"),
    [(0.0799, 0.08), (0.0702, 0.07), (0.02509, 0.025), (0.02472, 0.0247), (0.1083, 0.108), (0.0736, 0.0736)],
)
def test_the_size_of_the_squares_is_a_suggestion(measured_m, likely_m):
    """The nearest millimeter, if it is within the error of the measurement."""
    sides = (measured_m, measured_m * 1.001, measured_m * 0.999)
    draft = drafted(description(), board=board(squares_m=sides))
    assert f"# square_m: {likely_m:g}\n" in draft.text
    assert f"Suggestion: {likely_m * 1e3:g} mm ({measured_m * 1e3:.2f} mm by" in " ".join(
        map(str, draft.todo)
    )
    assert loaded(draft).board.square_m is None
    sides = (measured_m, measured_m * 1.05, measured_m)
    scattered = drafted(description(), board=board(squares_m=sides))
    assert "Suggestion" not in scattered.text


def counter(side, bits=16, **changes):
    return NumberField(f"/ticks/{side}", "data", True, bits, **changes)


def bare(**changes):
    topics = tuple(TopicInfo(f"/ticks/{side}", "std_msgs/msg/UInt16", 5) for side in ("left", "right"))
    return description(extra=topics, joint_names=HEAD_ONLY, **changes)


@pytest.mark.parametrize(
    ("bits", "wraps", "filled"),
    [(16, None, 16), (8, None, 8), (32, None, None), (32, 16, 16), (None, None, None), (64, 32, 32)],
)
def test_tick_counters_wait_for_their_resolution(bits, wraps, filled):
    """The file cannot be used before the user states the steps per turn."""
    fields = [counter(side, bits, wraps=wraps) for side in ("left", "right")]
    draft = drafted(bare(numbers=tuple(fields)))
    assert set(todo(draft)) == {"wheels.left.ticks_per_revolution, wheels.right.ticks_per_revolution"}
    wheels = YAML(typ="safe").load(draft.text)["wheels"]
    expected = {"topic": "/ticks/left", "field": "data", "ticks_per_revolution": "TODO", "sign": 1}
    assert wheels["left"] == expected | ({} if filled is None else {"bits": filled})
    with pytest.raises(ValueError, match="ticks_per_revolution"):
        loaded(draft)


def test_a_joint_in_other_messages_is_asked_for_with_its_candidates():
    names = {"/joint_states": ("wheel_left_joint", "wheel_right_joint", "head_pan_joint")}
    numbers = (NumberField("/tilt_servo", "angle", False),)
    draft = drafted(description(joint_names=names, numbers=numbers))
    assert "no joint state for 'head_tilt_joint'" in todo(draft)["joints.fields"]
    assert '# candidate: topic "/tilt_servo", field "angle" (number, unit unknown)' in draft.text
    loaded(draft)


def test_nominal_values_that_the_urdf_lacks_are_asked_for():
    meshes = AT_BASE.replace('<cylinder radius="0.2" length="0.1"/>', "<mesh/>")
    draft = drafted(description(urdf=meshes))
    assert "wheel joints are 0.5 m apart, radii are not in it" in todo(draft, needed=False)["nominal.wheels"]
    assert loaded(draft).nominal.wheels is None


def test_a_given_urdf_replaces_that_of_the_recording(tmp_path):
    (tmp_path / "mine.urdf").write_text(AT_BASE)
    given = RigConfig.model_validate({"head": {"urdf": tmp_path / "mine.urdf"}})
    draft = draft_rig(survey_rig(given, description(urdf=None)), "log", "robots/mine.urdf")
    assert keys(draft)["head.urdf"] == "robots/mine.urdf"
    assert str(loaded(draft).head.urdf) == "robots/mine.urdf"
    assert loaded(draft).nominal.wheels.separation_m == 0.5
    assert todo(draft) == {}


def test_names_of_readings():
    assert may_be_a_reading("/wheel_ticks/left", "data")
    assert may_be_a_reading("/base", "left.encoder")
    assert may_be_a_reading("/head", "tilt")
    assert not may_be_a_reading("/wheels/cmd", "left")
    assert not may_be_a_reading("/head/pan/setpoint", "data")
    assert not may_be_a_reading("/battery", "voltage")


def test_a_chain_of_transforms_is_drafted():
    T = np.stack([se3.transform(se3.rotation_z(a), np.array([0.1, 0, 1])) for a in np.linspace(0, 1, 5)])
    fixed = np.stack([se3.transform(np.eye(3), np.array([0, 0.06, 0.1]))] * 5)
    transforms = {("base_link", "neck"): T, ("neck", "stereo_left_optical"): fixed}
    log = replace(description(urdf=None, extra=(TF,)), transforms=transforms)
    draft = drafted(log)
    assert keys(draft)["head.head_frame"] == "neck"
    again, first = (resolve_rig(config, log)[0] for config in (loaded(draft), RigConfig()))
    assert again.chain.joints == first.chain.joints == ("neck",)
    assert math.isclose(again.nominal.T_h_reference[1, 3], 0.06)


@pytest.mark.parametrize(
    "odd", ["\x1b[31m", "\u202e\u200f", "\x85\u2028", "\x9b", "\U0001f600", "\U000e0001", '"\\']
)
def test_names_with_control_characters(odd):
    """Some stood in comments, where YAML refuses them; characters beyond 16 bits came back as two."""
    names = ("wheel_left_joint", "wheel_right_joint", f"head_pan_joint{odd}", f"head{odd}")
    draft = drafted(description(joint_names={"/joint_states": names}), f"log{odd}")
    assert "joints.fields" in todo(draft)
    assert all(line.isprintable() for line in draft.text.splitlines())
    assert "\n".join(draft.text.splitlines()) + "\n" == draft.text
    loaded(draft)

    wheels = (f"wheel_left_joint{odd}", f"wheel_right_joint{odd}", "head_pan_joint", "head_tilt_joint")
    draft = drafted(description(urdf=None, joint_names={"/joint_states": wheels}))
    assert loaded(draft).wheels.left.joint == wheels[0]
    assert load_yaml(draft.text)["wheels"]["right"]["joint"] == wheels[1]


def test_a_draft_of_very_many_and_very_long_names_can_be_read_again():
    """It listed them all, and was larger than a rig.yaml may be."""
    names = [*HEAD_ONLY["/joint_states"], "wheel_left_joint", "wheel_right_joint"]
    for more in ([f"finger_{k}_joint" for k in range(2000)], ["x" * 10**5]):
        for kept in (names, names[1:]):
            draft = drafted(description(joint_names={"/joint_states": (*kept, *more)}))
            assert len(draft.text) < 20_000
            load_yaml(draft.text)
