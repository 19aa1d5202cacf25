import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError, MobilecalError, RecordingError
from mobilecal_cli.files.reading import load_yaml
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model.rig import CameraInfo, JointField, WheelGeometry, WheelSource
from mobilecal_cli.model.signals import NumberField, RobotDescription, TopicInfo
from mobilecal_cli.rig.cameras import camera_rig, image_topics
from mobilecal_cli.rig.config import RigConfig, checked_settings, load_rig
from mobilecal_cli.rig.draft import draft_rig
from mobilecal_cli.rig.head import fixed_pose, outside_chain, urdf_of_transforms
from mobilecal_cli.rig.names import pairs, side_of, words
from mobilecal_cli.rig.resolve import complete_rig, survey_rig
from mobilecal_cli.rig.settings import wheel_settings
from mobilecal_cli.rig.wheels import may_have_wheels

URDF = """<robot name="r">
<joint name="wheel_left_joint" type="continuous"><parent link="base_link"/><child link="wl"/><origin xyz="{x} 0.25 0.1"/></joint>
<joint name="wheel_right_joint" type="continuous"><parent link="base_link"/><child link="wr"/><origin xyz="{x} -0.25 0.1"/></joint>
<link name="wl"><collision><geometry><cylinder radius="0.2" length="0.1"/></geometry></collision></link>
<link name="wr"><collision><geometry><cylinder radius="0.2" length="0.1"/></geometry></collision></link>
<joint name="head_pan_joint" type="revolute"><parent link="base_link"/><child link="pan"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/></joint>
<joint name="head_tilt_joint" type="revolute"><parent link="pan"/><child link="tilt"/><axis xyz="0 1 0"/></joint>
<joint name="arm_pan" type="revolute"><parent link="base_link"/><child link="arm"/></joint>
</robot>"""
AT_BASE = URDF.format(x=0)
JOINTS = ("wheel_left_joint", "wheel_right_joint", "head_pan_joint", "head_tilt_joint", "arm_pan")
HEAD_ONLY = {"/joint_states": ("head_pan_joint", "head_tilt_joint")}
FRONT = ("front_left_wheel", "front_right_wheel")
TF = TopicInfo("/tf", "tf2_msgs/msg/TFMessage", 100)


NO_P = np.zeros((3, 4))


def info(side="left", baseline=0.12, **changes):
    values = {
        "frame_id": f"stereo_{side}_optical",
        "width": 640,
        "height": 480,
        "K": np.array([[550.0, 0, 320], [0, 551.0, 240], [0, 0, 1]]),
        "D": np.array([-0.2, 0.1, 0, 0, 0]),
        "distortion": "plumb_bob",
        "R": se3.exp_so3(np.array([0.01, -0.02, 0.005]) * (1 if side == "left" else -1)),
        "P": np.array(
            [[540.0, 0, 322, 0 if side == "left" else -540 * baseline], [0, 540, 241, 0], [0, 0, 1, 0]]
        ),
    }
    return CameraInfo(**(values | changes))


def description(
    images=("/stereo/left/image_raw", "/stereo/right/image_raw"), extra=(), urdf=AT_BASE, **changes
):
    infos = {"/stereo/left/camera_info": info("left"), "/stereo/right/camera_info": info("right")}
    topics = [TopicInfo(name, "sensor_msgs/msg/Image", 10) for name in images]
    topics += [TopicInfo(name, "sensor_msgs/msg/CameraInfo", 10) for name in infos]
    topics += [TopicInfo("/joint_states", "sensor_msgs/msg/JointState", 100), *extra]
    values = {
        "topics": tuple(topics),
        "infos": infos,
        "image_frames": {},
        "joint_names": {"/joint_states": JOINTS},
        "urdfs": {"/robot_description": urdf} if urdf else {},
    }
    return RobotDescription(**(values | changes))


def config(**sections):
    return RigConfig.model_validate(sections)


def resolve_rig(made, log):
    """The rig, and the notes for the report."""
    survey = survey_rig(made, log)
    return complete_rig(survey), survey.notes


def test_a_log_tells_everything():
    rig, _ = resolve_rig(RigConfig(), description())
    assert rig.sources.image == {"left": "/stereo/left/image_raw", "right": "/stereo/right/image_raw"}
    assert rig.sources.info["right"] == "/stereo/right/camera_info"
    assert rig.chain.joints == ("head_pan_joint", "head_tilt_joint")
    assert (rig.chain.pan, rig.chain.tilt) == ("head_pan_joint", "head_tilt_joint")
    assert (rig.chain.base_frame, rig.chain.head_frame) == ("base_link", "tilt")
    assert rig.sources.wheels["left"].joint == "wheel_left_joint"
    assert rig.nominal.wheels is not None
    assert (rig.nominal.wheels.radius_left_m, rig.nominal.wheels.separation_m) == (0.2, 0.5)
    assert rig.cameras.baseline_m == pytest.approx(0.12)
    assert not rig.cameras.rectified


@pytest.mark.parametrize("other", ["a camera info", "an empty topic"])
def test_a_stereo_pair_with_the_images_of_one_camera(other):
    """With an empty topic of the other, as in a recording that was cut off, the advice was to measure squares."""
    log = description(images=("/stereo/left/image_raw",))
    if other == "an empty topic":
        empty = TopicInfo("/stereo/right/image_raw", "sensor_msgs/msg/Image", 0)
        kept = tuple(topic for topic in log.topics if topic.name != "/stereo/right/camera_info")
        infos = {"/stereo/left/camera_info": info("left")}
        log = replace(log, topics=(*kept, empty), infos=infos)
    with pytest.raises(RecordingError, match="has none on /stereo/right/image_raw") as error:
        resolve_rig(RigConfig(), log)
    assert error.value.hint.startswith("record /stereo/right/image_raw too;")
    alone, _ = resolve_rig(config(board={"square_m": 0.08}), log)
    assert alone.cameras.names == ("camera",)


def test_raw_stereo_geometry_is_what_rectification_says():
    cameras = resolve_rig(RigConfig(), description())[0].cameras
    # A point, by hand: turn into the right rectified frame, where it is 0.12 m further left.
    point_r = np.array([0.3, -0.2, 2.0])
    point_c = se3.act(cameras.T_c_each[1], point_r[None])[0]
    left, right = info("left"), info("right")
    assert left.R @ point_c == pytest.approx(right.R @ point_r + [0.12, 0, 0], abs=1e-12)


def test_rectified_images_use_the_projection_matrices():
    topics = ("/stereo/left/image_rect", "/stereo/right/image_rect")
    cameras = resolve_rig(RigConfig(), description(topics))[0].cameras
    assert cameras.rectified
    assert cameras.each[0].K[0, 0] == 540
    assert cameras.each[0].D.size == 0
    assert cameras.T_c_each[1][:3, :3] == pytest.approx(np.eye(3))


def test_raw_and_rectified_images_together_are_refused():
    """The left one's name decided for both."""
    topics = [f"/stereo/{side}/{kind}" for side in ("left", "right") for kind in ("image_rect", "image_raw")]
    mixed = {"left": {"image": topics[1]}, "right": {"image": topics[2]}}
    said = "the images on /stereo/left/image_raw are raw, and those on /stereo/right/image_rect are rectified"
    with pytest.raises(ConfigError, match=said):
        resolve_rig(config(cameras=mixed), description(topics))
    assert resolve_rig(config(cameras=mixed | {"rectified": True}), description(topics))[0].cameras.rectified


def test_raw_comes_before_rectified_and_full_before_compressed():
    names = [f"/stereo/{side}/{kind}" for side in ("left", "right") for kind in ("image_rect", "image_raw")]
    kind = "sensor_msgs/msg/CompressedImage"
    compressed = [TopicInfo(f"/stereo/{side}/image_raw/compressed", kind, 1) for side in ("left", "right")]
    rig = resolve_rig(RigConfig(), description(names, compressed))[0]
    assert rig.sources.image["left"] == "/stereo/left/image_raw"
    rectified = resolve_rig(config(cameras={"rectified": True}), description(names, compressed))[0]
    assert rectified.sources.image["left"] == "/stereo/left/image_rect"
    only = resolve_rig(RigConfig(), description((), compressed))[0]
    assert only.sources.image["right"] == "/stereo/right/image_raw/compressed"
    assert only.sources.info["right"] == "/stereo/right/camera_info"


def two_robots():
    """The topics of one robot, in the namespaces of two; the second has larger wheels."""
    log, robots = description(), ("/robot1", "/robot2")
    return replace(
        log,
        topics=tuple(replace(t, name=robot + t.name) for robot in robots for t in log.topics),
        infos={robot + topic: own for robot in robots for topic, own in log.infos.items()},
        joint_names={f"{robot}/joint_states": JOINTS for robot in robots},
        urdfs={f"{robot}/robot_description": AT_BASE for robot in robots}
        | {"/robot2/robot_description": AT_BASE.replace('radius="0.2"', 'radius="0.3"')},
    )


@pytest.mark.parametrize(("robot", "radius_m"), [("/robot1", 0.2), ("/robot2", 0.3)])
def test_joints_and_urdf_are_those_of_the_robot_with_the_cameras(robot, radius_m):
    cameras = {side: {"image": f"{robot}/stereo/{side}/image_raw"} for side in ("left", "right")}
    rig, notes = resolve_rig(config(cameras=cameras), two_robots())
    assert rig.sources.joint_topics == [f"{robot}/joint_states"]
    assert {wheel.topic for wheel in rig.sources.wheels.values()} == {f"{robot}/joint_states"}
    assert rig.nominal.wheels is not None
    assert rig.nominal.wheels.radius_left_m == radius_m
    assert not any("URDF" in note for note in notes)
    chosen = config(cameras=cameras, joints={"topic": "/robot1/joint_states"})
    assert resolve_rig(chosen, two_robots())[0].sources.joint_topics == ["/robot1/joint_states"]


def test_commands_are_no_readings():
    commands = TopicInfo("/joint_commands", "sensor_msgs/msg/JointState", 500)
    joint_names = {"/joint_commands": JOINTS, "/joint_states": JOINTS}
    log = description(extra=[commands], joint_names=joint_names)
    rig, _ = resolve_rig(RigConfig(), log)
    assert rig.sources.joint_topics == ["/joint_states"]
    assert rig.sources.wheels["left"].topic == "/joint_states"
    named = resolve_rig(config(joints={"topic": "/joint_commands"}), log)[0]
    assert named.sources.joint_topics == ["/joint_commands"]


def test_base_link_off_the_axle_is_taken_out():
    rig, notes = resolve_rig(RigConfig(), description(urdf=URDF.format(x=-0.2)))
    T_v_h = head_pose(rig.chain, np.zeros(2))
    assert T_v_h[:3, 3] == pytest.approx([0.2, 0, 0.9])
    assert "not midway between the wheels" in notes[0]
    assert "x -200.0 mm" in notes[0]


def further_wheels(radius_m=0.2, kind="continuous", on="fixed"):
    """The URDF with two more wheels 0.4 m behind the others, on arms with joints of a kind."""
    joint = (
        '<joint name="arm_{side}" type="{on}"><parent link="base_link"/><child link="arm_{side}"/></joint>'
        '<joint name="wheel_rear_{side}_joint" type="{kind}"><parent link="arm_{side}"/><child link="rear_{side}"/>'
        '<origin xyz="-0.4 {y} 0.1"/></joint><link name="rear_{side}"><collision><geometry>'
        '<cylinder radius="{radius_m}" length="0.1"/></geometry></collision></link></robot>'
    )
    urdf = AT_BASE
    for side, y in (("left", 0.25), ("right", -0.25)):
        urdf = urdf.replace("</robot>", joint.format(side=side, y=y, radius_m=radius_m, kind=kind, on=on))
    return urdf


def test_wheels_that_are_not_read_carry_the_base_too():
    """One of four is not published: its opposite alone is no pair."""
    names = {"/joint_states": (*JOINTS, "wheel_rear_left_joint")}
    rig, notes = resolve_rig(RigConfig(), description(urdf=further_wheels(), joint_names=names))
    assert head_pose(rig.chain, np.zeros(2))[:3, 3] == pytest.approx([0.2, 0, 0.9])
    assert rig.sources.several_wheels
    assert [part.joint for part in rig.sources.wheels["left"].every] == ["wheel_left_joint"]
    assert rig.sources.wheels["left"].unread == ("wheel_rear_left_joint",)
    assert "not read: wheel_rear_left_joint, wheel_rear_right_joint" in notes[0]
    again = checked_settings({"wheels": {"left": wheel_settings(rig.sources.wheels["left"])}}, "")
    assert again.wheels.left.side_joints == ("wheel_left_joint", "wheel_rear_left_joint")


@pytest.mark.parametrize(
    ("urdf", "stated"),
    [
        (further_wheels(radius_m=0.1), None),
        (further_wheels(kind="fixed"), None),
        (further_wheels(on="continuous"), None),
        (further_wheels(), []),
    ],
    ids=["smaller", "fixed", "swivelling", "stated"],
)
def test_wheels_that_do_not_turn_with_their_side_carry_nothing(urdf, stated):
    wheels = {side: {"unread": stated} for side in ("left", "right")}
    rig, _ = resolve_rig(config(wheels=wheels), description(urdf=urdf))
    assert head_pose(rig.chain, np.zeros(2))[:3, 3] == pytest.approx([0, 0, 1])
    assert not rig.sources.several_wheels


def test_exchanged_readings_leave_the_wheels_where_they_are():
    """An encoder's cable in the other socket: the axle of the URDF does not turn around with the names."""
    crossed = {"left": {"joint": JOINTS[1]}, "right": {"joint": JOINTS[0]}}
    rigs = (resolve_rig(made, description())[0] for made in (RigConfig(), config(wheels=crossed)))
    np.testing.assert_array_equal(*(head_pose(rig.chain, np.zeros(2)) for rig in rigs))


CAMERA = """<joint name="mount" type="{kind}"><parent link="{parent}"/><child link="cam"/><origin xyz="0.03 0.06 0.05"/></joint>
<joint name="optical" type="fixed"><parent link="cam"/><child link="stereo_left_optical"/><origin rpy="0 0 1"/></joint>
</robot>"""
OPTICAL = "stereo_left_optical"
WITH_CAMERA = AT_BASE.replace("</robot>", CAMERA.format(kind="fixed", parent="tilt"))


@pytest.mark.parametrize(
    ("kind", "parent", "drawn"),
    [("fixed", "tilt", True), ("revolute", "tilt", False), ("fixed", "base_link", False)],
)
def test_the_urdf_draws_the_camera_on_the_head(kind, parent, drawn):
    urdf = AT_BASE.replace("</robot>", CAMERA.format(kind=kind, parent=parent))
    rig = resolve_rig(config(head={"head_frame": "tilt"}), description(urdf=urdf))[0]
    assert rig.setting_sources["nominal head_eye"] == ("URDF" if drawn else "none")
    if drawn:
        expected = se3.transform(se3.rotation_z(1.0), np.array([0.03, 0.06, 0.05]))
        assert np.allclose(rig.nominal.T_h_reference, expected)
    else:
        assert rig.nominal.T_h_reference is None


def test_the_camera_may_be_beside_the_head_link():
    """Fixed joints from both to the link that carries them state the pose as well."""
    plate = '<joint name="plate" type="fixed"><parent link="tilt"/><child link="head_link"/><origin xyz="0 0 0.1"/></joint>'
    urdf = AT_BASE.replace("</robot>", plate + CAMERA.format(kind="fixed", parent="tilt"))
    rig = resolve_rig(RigConfig(), description(urdf=urdf))[0]
    assert rig.chain.head_frame == "head_link"
    assert rig.nominal.T_h_reference[:3, 3] == pytest.approx([0.03, 0.06, -0.05])


@pytest.mark.parametrize(
    ("parent", "read", "head"),
    [
        ("tilt", True, "plate"),  # a third joint of the head
        ("tilt", False, "tilt"),  # a bracket that is set by hand
        ("base_link", True, "plate"),  # the tilt joint moves another camera
    ],
)
def test_joints_behind_the_tilt_joint_and_beside_it(parent, read, head):
    roll = (
        f'<joint name="neck_roll" type="revolute"><parent link="{parent}"/><child link="plate"/>'
        '<axis xyz="1 0 0"/></joint>'
    )
    urdf = AT_BASE.replace("</robot>", roll + CAMERA.format(kind="fixed", parent="plate"))
    recorded = description(urdf=urdf, joint_names={"/joint_states": (*JOINTS, *["neck_roll"] * read)})
    chain = resolve_rig(RigConfig(), recorded)[0].chain
    assert chain.head_frame == head
    assert ("neck_roll" in chain.joints) == read


def test_a_tilt_joint_that_is_fixed_is_none_of_the_head_and_not_drafted():
    urdf = AT_BASE.replace('"head_tilt_joint" type="revolute"', '"head_tilt_joint" type="fixed"')
    recorded = description(urdf=urdf, joint_names={"/joint_states": (*JOINTS[:3], "arm_pan")})
    rig = resolve_rig(config(), recorded)[0]
    assert (rig.chain.pan, rig.chain.tilt, rig.chain.joints) == ("head_pan_joint", "", ("head_pan_joint",))
    drafted = {one.key for one in draft_rig(survey_rig(config(), recorded), "log.mcap").filled}
    assert drafted & {"joints.pan", "joints.tilt"} == {"joints.pan"}


def test_flag_file_and_log_are_told_apart(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("joints: {pan: head_pan_joint}", encoding="utf-8")
    rig = resolve_rig(load_rig(path, {"joints.tilt": "head_tilt_joint"}), description())[0]
    assert rig.setting_sources["pan joint head_pan_joint"] == "file"
    assert rig.setting_sources["tilt joint head_tilt_joint"] == "flag"
    assert rig.setting_sources["left images /stereo/left/image_raw"] == "log"
    assert rig.setting_sources["reference camera left"] == "default"
    assert resolve_rig(config(noise={"joint_rad": 0.001}), description())[0].noise == {"joint_rad": 0.001}


def test_two_stereo_cameras_are_not_guessed():
    front = tuple(f"/front/{side}/image_{kind}" for side in ("left", "right") for kind in ("raw", "rect"))
    rear = tuple(name.replace("front", "rear") for name in front)
    with pytest.raises(ConfigError, match="several pairs of image topics") as told:
        resolve_rig(RigConfig(), description((*front, *rear)))
    assert "/front/left/image_raw and /front/right/image_raw; /rear/left" in told.value.message
    one = config(cameras={"left": {"image": "/rear/left/image_raw"}})
    infos = {f"/rear/{side}/camera_info": info(side) for side in ("left", "right")}
    rig = resolve_rig(one, description((*front, *rear), infos=infos))[0]
    assert rig.sources.image["right"] == "/rear/right/image_raw"


def test_wheels_on_a_moving_part_are_noted():
    wheel = 'type="continuous"><parent link="{}"/>'
    steered = AT_BASE.replace(wheel.format("base_link"), wheel.format("axle")).replace(
        "</robot>",
        '<joint name="roll" type="revolute"><parent link="base_link"/><child link="axle"/></joint>\n</robot>',
    )
    _, (note,) = resolve_rig(RigConfig(), description(urdf=steered))
    assert "the wheels move against base_link with roll" in note
    assert resolve_rig(RigConfig(), description())[1] == ()


def test_explicit_chain_needs_no_urdf():
    chain = [{"xyz_m": [0, 0, 1]}, {"joint": "head_pan_joint", "axis": [0, 0, 3]}]
    rig = resolve_rig(config(head={"chain": chain, "head_frame": "cam_mount"}), description(urdf=None))[0]
    assert rig.chain.joints == ("head_pan_joint",)
    assert rig.chain.head_frame == "cam_mount"
    assert head_pose(rig.chain, np.array([np.pi / 2]))[:3, 0] == pytest.approx([0, 1, 0], abs=1e-15)


ALONE = {"images": ("/camera/image",), "infos": {"/camera/camera_info": info()}}
#: rig.yaml, what the recording has in place of the usual, and the error.
MISSING = [
    ("", ALONE, ConfigError, "one camera does not show"),
    ("", {"images": ()}, RecordingError, "no image topics were recorded"),
    ("", {"joint_names": {}}, RecordingError, "no joint is named as a left or right wheel"),
    ("", {"joint_names": {"/joint_states": JOINTS[1:]}}, RecordingError, "no joint is named as a left or"),
    ("", {"joint_names": {"/joint_states": (*JOINTS, *FRONT)}}, ConfigError, "several pairs of joints could"),
    ("", {"joint_names": {"/joint_states": JOINTS[:3]}}, RecordingError, "no joint state for 'head_tilt"),
    ("", {"infos": {}}, RecordingError, "no camera info for the left"),
    ("", {"urdf": None}, RecordingError, "the head chain is unknown"),
    ("", {"urdf": "<robot"}, ConfigError, "not valid XML"),
    ("cameras: {left: {image: /nope}}", {}, RecordingError, "left.image: the topic /nope contains no images"),
    ("cameras: {front: {image: /nope}}", {}, RecordingError, "cameras.front.image: the topic /nope"),
    ("cameras: {left: {info: /nope}}", {}, RecordingError, "/nope contains no camera info"),
    ("joints: {topic: /nope}", {}, RecordingError, "/nope contains no joint states"),
    ("wheels: {left: {joint: nope}}", {}, RecordingError, "no joint 'nope'"),
    ("wheels: {left: {topic: /nope, field: data}}", {}, RecordingError, "/nope contains no messages"),
    ("wheels: {left: {unread: [rear]}}", {}, ConfigError, "left.unread: the URDF has no joint"),
    ("head: {head_frame: nope}", {}, ConfigError, "no link 'nope'"),
    (f"head: {{head_frame: {OPTICAL}}}", {"urdf": WITH_CAMERA}, ConfigError, f"{OPTICAL} is the frame of"),
]


@pytest.mark.parametrize(("text", "changes", "error", "said"), MISSING)
def test_what_is_missing_is_named(text, changes, error, said):
    with pytest.raises(error) as caught:
        resolve_rig(config(**(load_yaml(text) or {})), description(**changes))
    assert said in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize(
    ("left", "right", "words_"),
    [
        (info("left"), info("right", baseline=0.0), "no baseline"),
        (
            info(P=NO_P),
            info("right", P=NO_P),
            "no baseline: P is all zeros in the camera info of left and right",
        ),
        (info("left"), info("right", P=NO_P), "P is all zeros in the camera info of right"),
        (info("left"), info("right", baseline=-0.12), "120.0 mm to the left of the left camera"),
        (info("left", width=0), info("right"), "0 x 480"),
    ],
)
def test_bad_calibrations(left, right, words_):
    infos = {"/stereo/left/camera_info": left, "/stereo/right/camera_info": right}
    with pytest.raises(MobilecalError) as caught:
        resolve_rig(RigConfig(), description(infos=infos))
    assert words_ in caught.value.message
    if "no baseline" in words_:
        assert "or state cameras.right.pose" in caught.value.hint


@pytest.mark.parametrize("of_head", ["tilt", "left_optical_frame"])
def test_a_driver_that_names_the_head_itself(of_head):
    """The outputs then had a transform from a frame to itself."""
    infos = {f"/stereo/{side}/camera_info": info(side, frame_id=of_head) for side in ("left", "right")}
    recorded = description(infos=infos, urdf=AT_BASE.replace('"tilt"', f'"{of_head}"'))
    if of_head == "tilt":
        rig, notes = resolve_rig(RigConfig(), recorded)
        assert (rig.chain.head_frame, rig.cameras.of_reference.frame_id) == ("tilt", "left_optical_frame")
        assert rig.nominal.T_h_reference is None
        assert notes[0] == (
            "The frame_id of the left camera is that of the head, tilt. "
            "The outputs call its optical frame left_optical_frame."
        )
        return
    with pytest.raises(
        ConfigError, match="left_optical_frame is the frame of the left camera, not of the head"
    ):
        resolve_rig(RigConfig(), recorded)


def test_a_head_frame_before_a_joint_that_is_read_is_noted():
    log = description(urdf=WITH_CAMERA)
    said = [resolve_rig(config(head={"head_frame": of}), log)[1] for of in ("tilt", "pan")]
    assert said[0] == ()
    assert said[1] == (
        "Joint head_tilt_joint moves the camera, but the head chain ends before it, at pan. Set head.head_frame to tilt.",
    )


def test_cameras_of_an_unknown_model_are_refused_and_drafted():
    """`init` writes a draft with the reason; `calibrate` refuses the model by its name."""
    why = "/stereo/right/camera_info: unknown distortion model 'double_sphere'; known: plumb_bob"
    poor = description(
        infos={"/stereo/left/camera_info": info("left")},
        unusable={"/stereo/right/camera_info": RecordingError(why, "calibrate the camera")},
    )
    with pytest.raises(RecordingError, match="unknown distortion model 'double_sphere'") as told:
        resolve_rig(RigConfig(), poor)
    assert "calibrate the camera" in told.value.hint
    draft = draft_rig(survey_rig(RigConfig(), poor), "log")
    assert [(todo.key, todo.why.split(";")[0]) for todo in draft.todo if todo.needed] == [
        ("cameras", why.split(";")[0])
    ]
    assert '  left: {image: "/stereo/left/image_raw"' in draft.text


def test_a_wheel_that_drops_is_no_wheel():
    names = {"/joint_states": (*JOINTS, "wheel_drop_left_joint", "wheel_drop_right_joint")}
    rig, _ = resolve_rig(RigConfig(), description(joint_names=names))
    assert rig.sources.wheels["left"].joint == "wheel_left_joint"


def test_names():
    assert words("/leftCamera/image_raw") == ["left", "camera", "image", "raw"]
    assert side_of("/stereo/left/image") == "left"
    assert side_of("wheel_joint_r") == "right"
    assert side_of("/left/right") is None
    assert pairs(["/a/left", "/a/right", "/b/left", "/c"]) == [{"left": "/a/left", "right": "/a/right"}]
    assert pairs(["/d400/infra1/image", "/d400/infra2/image"])[0]["right"] == "/d400/infra2/image"


def test_joints_in_other_messages_than_joint_states():
    """Only the pan is in joint states; the tilt has a field of its own."""
    topic = TopicInfo("/servo", "std_msgs/msg/Float64", 100)
    names = {"/joint_states": tuple(name for name in JOINTS if name != "head_tilt_joint")}
    fields = {"head_tilt_joint": {"topic": "/servo", "field": "data", "unit": "deg"}}
    rig = resolve_rig(config(joints={"fields": fields}), description(extra=[topic], joint_names=names))[0]
    assert rig.sources.elsewhere == {"head_tilt_joint": JointField("/servo", "data", np.radians(1))}
    assert rig.sources.joint_topics == ["/joint_states"]
    with pytest.raises(RecordingError, match=r"joints\.fields: the topic /servo contains no messages"):
        resolve_rig(config(joints={"fields": fields}), description(joint_names=names))
    with pytest.raises(ConfigError, match="'arm' is not a joint between base_link and tilt"):
        resolve_rig(config(joints={"fields": {"arm": fields["head_tilt_joint"]}}), description(extra=[topic]))


def odometry(*topics):
    return [TopicInfo(topic, "nav_msgs/msg/Odometry", 100) for topic in topics]


def test_odometry_with_and_without_the_wheels_that_it_was_made_with():
    bare = description(extra=odometry("/odom"), joint_names=HEAD_ONLY)
    rig = resolve_rig(RigConfig(), bare)[0]
    drawn = WheelGeometry(0.1, 0.1, 0.5)  # the separation of the URDF
    assert rig.sources.wheels["left"] == WheelSource(
        "/odom", baked_in=drawn, assumed=True, separation_share=0.2
    )
    assert rig.nominal.wheels == rig.sources.assumed_wheels == drawn
    stated = resolve_rig(config(wheels={"odometry_separation_m": 0.37}), bare)[0]
    assert stated.sources.assumed_wheels.separation_m == 0.37
    nominal = {"wheels": {"radius_left_m": 0.2, "radius_right_m": 0.21, "separation_m": 0.5}}
    rig = resolve_rig(config(wheels={"odometry": "/odom"}, nominal=nominal), bare)[0]
    assert rig.sources.wheels["left"] == WheelSource("/odom", baked_in=WheelGeometry(0.21, 0.2, 0.5))
    with pytest.raises(RecordingError, match=r"/joint_states contains no nav_msgs/msg/Odometry") as told:
        resolve_rig(config(wheels={"odometry": "/joint_states"}, nominal=nominal), bare)
    assert told.value.hint == "topics with nav_msgs/msg/Odometry: /odom"


@pytest.mark.parametrize(
    ("topics", "frames", "chosen"),
    [
        (("/odom", "/odometry/filtered"), {}, "/odom"),
        (("/husky_base/odom", "/odometry/filtered", "/zed/odom"), {}, "/husky_base/odom"),
        (("/odom", "/wheel_odom"), {}, "/wheel_odom"),
        (("/odom", "/odom/unfiltered"), {}, "/odom/unfiltered"),
        (("/odom", "/t265"), {"/t265": ("odom", "camera_pose_frame")}, "/odom"),
        (("/odom", "/where"), {"/where": ("map", "base_link")}, "/odom"),
    ],
)
def test_odometry_of_the_wheels_is_preferred(topics, frames, chosen):
    log = replace(description(extra=odometry(*topics), joint_names=HEAD_ONLY), odometry_frames=frames)
    assert resolve_rig(RigConfig(), log)[0].sources.wheels["right"].topic == chosen


def test_one_stated_wheel_is_not_completed_by_odometry():
    """The other wheel was that of the odometry, which another driver reads: two sources in one leg."""
    joints = {"/joint_states": (*HEAD_ONLY["/joint_states"], "motor_a", "motor_b")}
    log = description(extra=odometry("/odom"), joint_names=joints)
    with pytest.raises(ConfigError, match="no joint or counter is named as the left wheel") as caught:
        resolve_rig(config(wheels={"right": {"joint": "motor_a"}}), log)
    assert "wheels.left" in caught.value.hint
    assert "motor_b" in caught.value.hint


@pytest.mark.parametrize(
    ("topics", "said", "cure"),
    [
        (
            ("/odom", "/base/odom"),
            "several topics could be the wheel odometry: /base/odom, /odom",
            "odometry: /",
        ),
        (("/odometry/filtered",), "named as fused with other sensors", "{odometry: /odometry/filtered}"),
        (("/camera/odom/sample",), "is not named as that of wheels", "{odometry: /camera/odom/sample}"),
    ],
)
def test_other_odometry_is_a_choice(topics, said, cure):
    log = description(extra=sorted(odometry(*topics), key=lambda t: t.name), joint_names=HEAD_ONLY)
    with pytest.raises((RecordingError, ConfigError), match=said) as told:
        resolve_rig(RigConfig(), log)
    assert cure in told.value.hint
    rig = resolve_rig(config(wheels={"odometry": topics[0]}), log)[0]
    assert rig.sources.wheels["left"].topic == topics[0]


FOUR = {
    "Jackal": ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"),
    "corners": ("fl_wheel_joint", "fr_wheel_joint", "rl_wheel_joint", "rr_wheel_joint"),
    "after the word": ("wheel_fl", "wheel_fr", "wheel_bl", "wheel_br"),
    "side first": ("left_front_wheel", "right_front_wheel", "left_rear_wheel", "right_rear_wheel"),
    "numbers": ("left_wheel_1", "right_wheel_1", "left_wheel_2", "right_wheel_2"),
    "one word": ("lfwheel", "rfwheel", "lrwheel", "rrwheel"),
    "short": ("drivewhl_lf_joint", "drivewhl_rf_joint", "drivewhl_lr_joint", "drivewhl_rr_joint"),
}


@pytest.mark.parametrize("names", FOUR.values(), ids=FOUR)
def test_four_wheels_by_their_names(names):
    others = (*JOINTS[2:4], "left_caster_wheel_joint", "right_caster_wheel_joint", "arm_wheel_l")
    rig = resolve_rig(RigConfig(), description(joint_names={"/joint_states": (*others, *names)}))[0]
    found = {side: {one.joint for one in source.every} for side, source in rig.sources.wheels.items()}
    assert found == {"left": {names[0], names[2]}, "right": {names[1], names[3]}}


def test_four_wheels_as_configured():
    names = ("a", "b", "c", "d", "head_pan_joint", "head_tilt_joint")
    wheels = {"left": {"joints": ["a", "c"], "signs": [1, -1]}, "right": {"joints": ["b", "d"], "sign": -1}}
    rig = resolve_rig(config(wheels=wheels), description(joint_names={"/joint_states": names}))[0]
    assert [(one.joint, one.sign) for one in rig.sources.wheels["left"].every] == [("a", 1), ("c", -1)]
    assert [(one.joint, one.sign) for one in rig.sources.wheels["right"].every] == [("b", -1), ("d", -1)]
    wheels["right"]["joints"] = ["c", "d"]
    with pytest.raises(ConfigError, match="both read from c on /joint_states"):
        resolve_rig(config(wheels=wheels), description(joint_names={"/joint_states": names}))


@pytest.mark.parametrize(
    ("joints", "topic", "said"),
    [
        (
            ("front_left_steer_joint", "rear_left_wheel", "rear_right_wheel"),
            "/odom",
            "that steer: front_left",
        ),
        (("left_wheel", "right_wheel"), "/ackermann_cmd", "Ackermann drive"),
        (("fl_wheel", "fr_wheel", "rl_wheel", "rr_wheel"), "/mecanum_drive_controller/odom", "mecanum drive"),
    ],
)
def test_other_drives_are_refused(joints, topic, said):
    names = {"/joint_states": (*HEAD_ONLY["/joint_states"], *joints)}
    log = description(extra=odometry(topic), joint_names=names)
    with pytest.raises(RecordingError, match=said) as told:
        resolve_rig(RigConfig(), log)
    assert "mobilecal serves robots with differential drive or skid steering" in told.value.hint
    named = {"left": {"joints": joints[-2:-1]}, "right": {"joints": joints[-1:]}}
    assert resolve_rig(config(wheels=named), log)[0].sources.wheels["left"].joint == joints[-2]


def counted(*numbers, kind="my_msgs/msg/Base", topic="/core"):
    log = description(extra=[TopicInfo(topic, kind, 5)], joint_names=HEAD_ONLY)
    return replace(log, numbers=tuple(NumberField(topic, path, True) for path in numbers))


def test_counters_are_found_and_their_resolution_is_asked_for():
    log = counted("left_encoder", "right_encoder", "left_pwm", "right_pwm")
    with pytest.raises(
        RecordingError, match="left_encoder on /core, right_encoder on /core: tick co"
    ) as told:
        resolve_rig(RigConfig(), log)
    assert "ticks_per_revolution: N" in told.value.hint
    stated = {side: {"ticks_per_revolution": 1000} for side in ("left", "right")}
    left = resolve_rig(config(wheels=stated), log)[0].sources.wheels["left"]
    assert left == WheelSource("/core", None, "left_encoder", 1000)


@pytest.mark.parametrize(
    ("kind", "ticks", "bits"),
    [
        ("turtlebot3_msgs/msg/SensorState", 4096, None),
        ("kobuki_msgs/msg/SensorState", 2578.33, 16),
        ("irobot_create_msgs/msg/WheelTicks", 508.8, None),
        ("duckietown_msgs/msg/WheelEncoderStamped", 135, None),
    ],
)
def test_counters_of_known_drivers(kind, ticks, bits):
    rig = resolve_rig(RigConfig(), counted("left_encoder", "right_encoder", kind=kind))[0]
    assert rig.sources.wheels["right"] == WheelSource("/core", None, "right_encoder", ticks, bits)


def test_counters_named_enc():
    log = description(
        extra=[TopicInfo(f"/enc_{s}", "std_msgs/msg/Int32", 5) for s in "lr"], joint_names=HEAD_ONLY
    )
    log = replace(log, numbers=tuple(NumberField(f"/enc_{s}", "data", True) for s in "lr"))
    with pytest.raises(RecordingError, match="data on /enc_l, data on /enc_r: tick counters"):
        resolve_rig(RigConfig(), log)


def test_numbers_that_never_change_are_no_counters():
    """The resolution of an encoder, and the constants of its message."""
    log = counted("left.ticks", "right.ticks", "left.encoder_type", "right.encoder_type")
    numbers = (replace(number, still="type" in number.path) for number in log.numbers)
    stated = {side: {"ticks_per_revolution": 1000} for side in ("left", "right")}
    sources = resolve_rig(config(wheels=stated), replace(log, numbers=tuple(numbers)))[0].sources.wheels
    assert sources["left"].field == "left.ticks"


@pytest.mark.parametrize("still", [False, True])
def test_counters_that_stand_still_are_no_other_wheels(still):
    """Of a recording in which the head alone moves, those of the joint states are as good, and need no resolution."""
    log = counted("left.ticks", "right.ticks")
    numbers = tuple(replace(number, still=still) for number in log.numbers)
    assert may_have_wheels(replace(log, numbers=numbers)) is not still


def test_odometry_says_more_than_numbers_in_an_unknown_unit():
    """A refusal asked for the steps per turn of a displacement in meters."""
    log = counted("left_wheel_displacement", "right_wheel_displacement")
    log = replace(log, numbers=tuple(replace(number, integer=False) for number in log.numbers))
    with pytest.raises(RecordingError, match="in an unknown unit"):
        resolve_rig(RigConfig(), log)
    log = replace(log, topics=(*log.topics, *odometry("/odom")))
    assert resolve_rig(RigConfig(), log)[0].sources.wheels["left"].topic == "/odom"


ONLY_WHEELS = re.sub('<joint name="(head|arm).*\n', "", AT_BASE)


def test_where_only_wheels_move_the_camera_is_on_the_base():
    """Its frame is not in the URDF: head.head_frame was asked for."""
    caster = joint_of("caster_swivel_joint", "base_link", "caster", "continuous")
    wheels, urdf = {"/joint_states": JOINTS[:2]}, ONLY_WHEELS.replace("</robot>", caster + "</robot>")
    rig, notes = resolve_rig(RigConfig(), description(urdf=urdf, joint_names=wheels))
    assert (rig.chain.head_frame, rig.chain.joints) == ("base_link", ())
    assert any("taken as fixed to base_link" in note for note in notes)
    for more in ({"joint_names": {"/joint_states": JOINTS[:3]}}, {"urdf": AT_BASE.replace("tilt", "nod")}):
        with pytest.raises(ConfigError, match="the link that carries the camera is unknown"):
            resolve_rig(RigConfig(), description(**({"urdf": urdf, "joint_names": wheels} | more)))


def test_both_cameras_in_one_topic():
    both = {"image": "/stereo/image_raw", "layout": "stacked"}
    rig = resolve_rig(config(cameras={"both": both}), description(("/stereo/image_raw",)))[0]
    assert rig.sources.image == {"left": "/stereo/image_raw", "right": "/stereo/image_raw"}
    assert rig.sources.info == {"left": "/stereo/left/camera_info", "right": "/stereo/right/camera_info"}
    assert rig.sources.layout == "stacked"
    with pytest.raises(RecordingError, match=r"cameras\.both\.image: the topic /other contains no images"):
        resolve_rig(config(cameras={"both": {"image": "/other"}}), description())
    with pytest.raises(ValueError, match=r"give both\.image, or"):
        config(cameras={"both": both, "left": {"image": "/l"}})


def test_joints_that_only_tf_tells():
    states = {"/joint_states": ("wheel_left_joint", "wheel_right_joint")}
    rig = resolve_rig(RigConfig(), description(extra=[TF], joint_names=states))[0]
    assert (rig.sources.joint_topics, set(rig.sources.elsewhere)) == ([], set(rig.chain.joints))
    tilt = rig.sources.elsewhere["head_tilt_joint"]
    assert (tilt.topic, tilt.child, tilt.kind) == ("/tf", "tilt", "revolute")
    # Joint states come first, where there are any.
    assert resolve_rig(RigConfig(), description(extra=[TF]))[0].sources.elsewhere == {}
    with pytest.raises(RecordingError, match="no joint state for 'head_pan_joint'") as caught:
        resolve_rig(RigConfig(), description(joint_names=states))
    assert "set its topic and field in joints.fields" in caught.value.hint


def moving(axis, angles, origin=(0.1, 0.2, 0.3), slides=False):
    """(n, 4, 4) of a joint in motion."""
    T0 = se3.transform(se3.from_rpy(np.array([0.2, -0.1, 0.5])), np.array(origin))
    axis = np.array(axis) / np.linalg.norm(axis)
    steps = [
        se3.transform(np.eye(3), a * axis) if slides else se3.transform(se3.exp_so3(a * axis), np.zeros(3))
        for a in angles
    ]
    return np.stack([T0 @ step for step in steps])


def test_joints_out_of_transforms():
    angles = np.linspace(-0.4, 0.6, 20)
    transforms = {
        ("odom", "base_link"): np.stack([se3.exp(np.array([0, 0, a, a, 2 * a, 0])) for a in angles]),
        ("base_link", "torso"): moving((0, 0, 1), 0.1 * angles, slides=True),
        ("torso", "neck"): moving((0.1, 0, 1), angles),
        ("neck", "skull"): moving((0, -1, 0), angles**2),
        ("skull", "stereo_left_optical"): moving((0, 0, 1), np.zeros(20)),
        ("base_link", "antenna"): moving((1, 0, 0), np.zeros(1)),
    }
    urdf = urdf_of_transforms(transforms)
    kinds = {name: joint.kind for name, joint in urdf.joints.items()}
    assert kinds == {
        "base_link": "floating",
        "torso": "prismatic",
        "neck": "revolute",
        "skull": "revolute",
        "stereo_left_optical": "fixed",
        "antenna": "fixed",
    }
    np.testing.assert_allclose(urdf.joints["neck"].axis, np.array([0.1, 0, 1]) / np.hypot(0.1, 1), atol=1e-9)
    np.testing.assert_allclose(urdf.joints["skull"].axis, [0, 1, 0], atol=1e-9)
    np.testing.assert_array_equal(urdf.joints["neck"].T_parent_child, transforms["torso", "neck"][0])

    found = resolve_rig(RigConfig(), replace(description(urdf=None, extra=(TF,)), transforms=transforms))[0]
    assert (found.chain.pan, found.chain.tilt) == ("neck", "skull")
    assert found.chain.joints == ("torso", "neck", "skull")
    assert found.chain.head_frame == "skull"


@pytest.mark.parametrize("base", ["robot1/base_link", "chassis"])
def test_the_base_of_transforms_has_a_prefix_or_moves_freely(base):
    angles = np.linspace(-0.4, 0.6, 20)
    transforms = {
        ("odom", base): np.stack([se3.exp(np.array([0, 0, a, a, 2 * a, 0])) for a in angles]),
        (base, "neck"): moving((0, 0, 1), angles),
        ("neck", "skull"): moving((0, -1, 0), angles**2),
        ("skull", "stereo_left_optical"): moving((0, 0, 1), np.zeros(20)),
    }
    rig, _ = resolve_rig(RigConfig(), description(urdf=None, extra=(TF,), transforms=transforms))
    assert (rig.chain.base_frame, rig.chain.joints) == (base, ("neck", "skull"))


def test_all_that_moves_the_camera_in_transforms_is_its_head():
    """The pan joint of this pan-tilt unit carries a link named tilt: the head ended there."""
    angles = np.linspace(-0.4, 0.6, 20)
    transforms = {
        ("base_link", "ptu_tilt_link"): moving((0, 0, 1), angles),
        ("ptu_tilt_link", "ptu_tilted_link"): moving((0, -1, 0), angles**2),
        ("ptu_tilted_link", "stereo_left_optical"): moving((0, 0, 1), np.zeros(20)),
    }
    states = {"/joint_states": (*JOINTS[:2], "ptu_pan", "ptu_tilt")}
    log = description(urdf=None, extra=(TF,), transforms=transforms, joint_names=states)
    rig, _ = resolve_rig(RigConfig(), log)
    assert rig.chain.joints == ("ptu_tilt_link", "ptu_tilted_link")
    assert outside_chain(rig.chain, log) == []


def test_a_joint_behind_the_head_that_mimics_one_of_it_moves_the_camera():
    """No joint state names it: the head ended before it, and the tilt joint "did not fit"."""
    nod = joint_of("linkage", "tilt", "nod", "revolute").replace("</joint>", '<mimic joint="{}"/></joint>')
    for mimicked, head in (("head_tilt_joint", "nod"), ("unread", "tilt")):
        more = nod.format(mimicked) + joint_of("eye", "nod", "stereo_left_optical")
        urdf = AT_BASE.replace("</robot>", joint_of("unread", "arm", "hand", "revolute") + more + "</robot>")
        chain = resolve_rig(RigConfig(), description(urdf=urdf))[0].chain
        assert (chain.head_frame, chain.joints) == (head, ("head_pan_joint", "head_tilt_joint"))


@pytest.mark.parametrize("prefix", ["", "robot1/"])
def test_transforms_have_the_frame_prefix_of_robot_state_publisher(prefix):
    """Joints that are in the transforms alone were refused, and so was a camera on the base."""
    urdf = AT_BASE.replace("</robot>", joint_of("mount", "tilt", "stereo_left_optical") + "</robot>")
    static = {(f"{prefix}tilt", f"{prefix}stereo_left_optical"): moving((0, 0, 1), np.zeros(2))}
    log = description(urdf=urdf, extra=(TF,), joint_names={"/joint_states": JOINTS[:2]}, transforms=static)
    infos = {topic: replace(own, frame_id=prefix + own.frame_id) for topic, own in log.infos.items()}
    rig, _ = resolve_rig(RigConfig(), replace(log, infos=infos))
    ends = [(joint.parent, joint.child) for joint in rig.sources.elsewhere.values()]
    assert ends == [(f"{prefix}base_link", f"{prefix}pan"), (f"{prefix}pan", f"{prefix}tilt")]
    assert rig.nominal.T_h_reference is not None


def joint_of(name, parent, child, kind="fixed"):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'


def test_joints_on_the_way_to_the_camera_are_those_of_the_head():
    """Two joints tilt the camera, and one an arm."""
    more = joint_of("face_tilt", "tilt", "face", "revolute") + joint_of("eye", "face", "stereo_left_optical")
    urdf = AT_BASE.replace("</robot>", more + joint_of("hand_tilt", "arm", "hand", "revolute") + "</robot>")
    names = {"/joint_states": (*JOINTS, "face_tilt", "hand_tilt")}
    rig, _ = resolve_rig(RigConfig(), description(urdf=urdf, joint_names=names))
    assert rig.chain.joints == ("head_pan_joint", "head_tilt_joint", "face_tilt")
    assert (rig.chain.tilt, rig.chain.head_frame) == ("head_tilt_joint", "face")


def test_the_base_carries_the_wheels():
    """They and base_link hang from base_footprint."""
    wheels = AT_BASE.replace(
        '<parent link="base_link"/><child link="w', '<parent link="base_footprint"/><child link="w'
    )
    urdf = wheels.replace("</robot>", joint_of("lift", "base_footprint", "base_link") + "</robot>")
    rig, _ = resolve_rig(RigConfig(), description(urdf=urdf))
    assert (rig.chain.base_frame, rig.nominal.wheels.separation_m) == ("base_footprint", 0.5)


def test_odometry_shows_where_the_axle_is_if_the_urdf_does_not():
    """The camera was 50 mm off in the base's frame, with a PASS."""
    bare = re.sub('<joint name="wheel.*?</joint>', "", AT_BASE)
    odometry = {
        "extra": [TopicInfo("/odom", "nav_msgs/msg/Odometry", 9)],
        "joint_names": HEAD_ONLY,
        "odometry_frames": {"/odom": ("odom", "base_link")},
    }
    for urdf, ahead_m, x_m in ((bare, 0.0, 0.0), (bare, -0.05, -0.05), (AT_BASE, -0.05, 0.0)):
        log = description(urdf=urdf, odometry_ahead_m=ahead_m, **odometry)
        rig, notes = resolve_rig(RigConfig(), log)
        assert head_pose(rig.chain, np.zeros(2))[:3, 3] == pytest.approx([x_m, 0, 1])
        assert any("frame is on the axle" in note for note in notes) == bool(x_m)
    _, notes = resolve_rig(RigConfig(), description(urdf=bare))
    assert any("base_link is taken as midway between them" in note for note in notes)


def test_a_camera_on_the_base_is_in_its_frame():
    rig, _ = resolve_rig(config(head={"chain": [], "base_frame": "chassis"}), description(urdf=None))
    assert (rig.chain.base_frame, rig.chain.head_frame) == ("chassis", "chassis")


def test_transforms_that_do_not_lead_to_the_camera_are_said():
    transforms = {("base_link", "torso"): moving((0, 0, 1), np.zeros(3))}
    with pytest.raises(RecordingError, match="no transforms to the camera frame 'stereo_left_optical'"):
        resolve_rig(RigConfig(), replace(description(urdf=None), transforms=transforms))


def test_transforms_in_a_circle_come_to_an_end():
    still = np.stack([np.eye(4)] * 3)
    urdf = urdf_of_transforms({("a", "b"): still, ("b", "a"): still, ("b", "c"): still})
    np.testing.assert_array_equal(fixed_pose(urdf, "a", "c"), np.eye(4))


SQUARE = config(board={"square_m": 0.08})


def recorded(*topics, baseline_m=0.0):
    """A recording of images, each with a camera info of its own; those with a 2 or _1 are right cameras."""
    infos = {}
    for topic in topics:
        is_right = bool(re.search("2/|_1/|right", topic))
        infos[f"{topic.rsplit('/', 1)[0]}/camera_info"] = info(topic, baseline_m * is_right)
    images = tuple(TopicInfo(topic, "sensor_msgs/msg/Image", 9) for topic in topics)
    return RobotDescription(images, infos, {}, {}, {})


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        (("/camera/color/image_raw", "/camera/depth/image_rect_raw"), "/camera/color/image_raw"),
        (
            ("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw", "/camera/infra1/image_rect_raw"),
            "/camera/color/image_raw",
        ),
        (
            ("/camera/camera/color/image_raw", "/camera/camera/infra1/image", "/camera/camera/infra2/image"),
            "/camera/camera/color/image_raw",
        ),
        (("/oak/rgb/image_raw", "/oak/stereo/image_raw"), "/oak/rgb/image_raw"),
        (("/camera/rgb/image_raw", "/camera/ir/image_raw", "/camera/depth/image_raw"), "/camera/rgb/image_raw"),
        (("/usb_cam/image_raw", "/usb_cam/image_rect"), "/usb_cam/image_raw"),
        (("/zed2i/zed_node/rgb/image_rect_color", "/zed2i/zed_node/depth/depth_registered"),
         "/zed2i/zed_node/rgb/image_rect_color"),
        (("/camera/color/image_raw", "/camera/depth/image_raw", "/camera/ir/image_raw"), "/camera/color/image_raw"),
    ],
)  # fmt: skip
def test_the_color_camera_is_the_single_one(topics, chosen):
    assert image_topics(SQUARE, recorded(*topics)) == {"camera": chosen}


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("/t265/fisheye1/image_raw", "/t265/fisheye2/image_raw"),
        ("/camera1/image_raw", "/camera2/image_raw"),
        ("/rig/camera_0/image_raw", "/rig/camera_1/image_raw"),
        ("/cameraleft/image_raw", "/cameraright/image_raw"),
        ("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"),
        ("/zed/zed_node/left/image_rect_color", "/zed/zed_node/right/image_rect_color"),
        ("/oak/left/image_raw", "/oak/right/image_raw"),
        ("/camera/left_ir/image_raw", "/camera/right_ir/image_raw"),
        ("/left/image_raw", "/right/image_raw"),
    ],
)
def test_pairs_of_drivers(left, right):
    found = image_topics(
        SQUARE, recorded(right, left, "/camera/depth/image_raw", "/front/image_raw", baseline_m=0.06)
    )
    assert found == {"left": left, "right": right}


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        (("/left/image_raw", "/right/image_raw/compressed"), (0, 1)),
        (("/camera1/image_raw/compressed", "/camera2/image_raw"), (0, 1)),
        (("/left/image_raw", "/left/image_raw/compressed", "/right/image_raw/compressed"), (1, 2)),
        (("/left/image_rect", "/left/image_raw", "/right/image_rect", "/right/image_raw/compressed"), (0, 2)),
    ],
)
def test_a_pair_of_different_compression_where_there_is_no_other(topics, chosen):
    log = recorded(*topics, baseline_m=0.06)
    kinds = ("CompressedImage" if topic.endswith("compressed") else "Image" for topic in topics)
    images = tuple(TopicInfo(t, f"sensor_msgs/msg/{kind}", 9) for t, kind in zip(topics, kinds, strict=True))
    infos = {topic.replace("image_raw/", ""): each for topic, each in log.infos.items()}
    found = image_topics(RigConfig(), replace(log, topics=images, infos=infos))
    assert tuple(found.values()) == tuple(topics[k] for k in chosen)


@pytest.mark.parametrize(
    "topics",
    [
        ("/camera1/image_raw", "/camera2/image_raw"),  # no baseline: two single cameras
        ("/front/color/image_raw", "/back/color/image_raw"),
        ("/front/image_raw", "/side/image_raw", "/back/image_raw"),
        ("/front/image_raw", "/left/image_raw", "/right/image_raw"),  # no baseline: cameras all around
    ],
)
def test_several_cameras_are_the_choice_of_the_user(topics):
    with pytest.raises(ConfigError, match="several cameras could be meant") as told:
        image_topics(SQUARE, recorded(*topics))
    assert all(topic in told.value.message for topic in topics)
    assert told.value.hint.startswith("for a stereo pair, set cameras.left.image and cameras.right.image")


def test_one_camera_in_several_sizes_is_one():
    """The preview of an OAK-D: "several cameras could be meant", it said."""
    topics = ("/oakd/rgb/preview/image_raw", "/oakd/rgb/image_raw")
    log = recorded(*topics)
    frames = dict.fromkeys(topics, "oakd_rgb_camera_optical_frame")
    smaller = replace(log.infos["/oakd/rgb/preview/camera_info"], width=250, height=250)
    log = replace(log, infos={**log.infos, "/oakd/rgb/preview/camera_info": smaller}, image_frames=frames)
    assert [*image_topics(SQUARE, log).values()] == ["/oakd/rgb/image_raw"]
    alike = replace(log, infos={topic: replace(each, width=640) for topic, each in log.infos.items()})
    for other in (alike, replace(log, image_frames={})):
        with pytest.raises(ConfigError, match="several cameras could be meant"):
            image_topics(SQUARE, other)


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        (("/usb_cam/image_raw", "/apriltag/detections_image"), (0,)),
        (("/apriltag/left/image", "/apriltag/right/image", "/left/image_raw", "/right/image_raw"), (2, 3)),
    ],
)
def test_images_of_a_detector_without_camera_info_are_no_camera(topics, chosen):
    """They were a second camera, or a second pair."""
    log = recorded(*topics, baseline_m=0.06)
    infos = {topic: each for topic, each in log.infos.items() if not topic.startswith("/apriltag")}
    found = image_topics(SQUARE, replace(log, infos=infos))
    assert tuple(found.values()) == tuple(topics[k] for k in chosen)


def test_depth_alone_is_no_camera():
    with pytest.raises(RecordingError, match="this tool serves a stereo pair, a single camera"):
        image_topics(SQUARE, recorded("/camera/depth/image_raw"))


def test_named_cameras_stand_where_they_are_configured_or_drawn():
    names = {"front": {"image": "/front/image_raw"}, "side": {"image": "/side/image_raw"}}
    T = se3.transform(se3.from_rpy(np.array([0.0, 0.4, 0.0])), np.array([0.1, 0.2, 0.3]))
    infos = {name: info(name) for name in names}
    square = {"square_m": 0.08}
    rig = camera_rig(infos, False, config(board=square, cameras=names), lambda frame, other: T)
    np.testing.assert_array_equal(rig.T_c_each[1], T)
    assert (rig.names, rig.reference, rig.calibrated) == (("front", "side"), "front", False)
    with pytest.raises(RecordingError, match="the pose of camera side"):
        camera_rig(infos, False, config(board=square, cameras=names), lambda frame, other: None)
    names["side"]["pose"] = {"translation_m": [0, 0, 0.5], "quaternion_xyzw": [0, 0, 0, 1]}
    referred = config(board=square, cameras={**names, "reference": "side"})
    rig = camera_rig(infos, False, referred, lambda frame, other: None)
    assert rig.T_c_reference[:3, 3] == pytest.approx([0, 0, 0.5])
    with pytest.raises(ConfigError, match="not show the size of the board's squares"):
        camera_rig(infos, False, config(cameras=names), lambda frame, other: T)


def test_a_base_link_that_leans_against_its_footprint():
    """The floor was taken as that of base_link: the camera was turned by what this leans, with a PASS."""
    onto_floor = '<joint name="lift" type="fixed"><parent link="base_footprint"/><child link="base_link"/>'
    onto_floor += '<origin xyz="0 0 0.1" rpy="0 0.04 0"/></joint></robot>'
    bare = re.sub('<joint name="wheel.*?</joint>', "", AT_BASE)
    for urdf, height_m in (
        (AT_BASE, 0.9),
        (bare, 1.0),
    ):  # of the head above the wheels' centers, and the base
        rig, notes = resolve_rig(RigConfig(), description(urdf=urdf.replace("</robot>", onto_floor)))
        assert rig.chain.base_frame == "base_link"
        T = head_pose(rig.chain, np.zeros(2))
        assert T[:3, :3] == pytest.approx(se3.from_rpy(np.array([0, 0.04, 0])))
        assert T[:3, 3] == pytest.approx(height_m * np.array([np.sin(0.04), 0, np.cos(0.04)]))
        assert any("base_link leans by 2.29 degrees against base_footprint" in note for note in notes)
