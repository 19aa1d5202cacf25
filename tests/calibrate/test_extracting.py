"""Several recordings of one robot: camera infos that differ, and errors in one of them."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mobilecal_cli.calibrate.detect import plan_recording
from mobilecal_cli.calibrate.extract import _other_cameras, describe, extract, other_size, wrong_chain
from mobilecal_cli.calibrate.inspect import inspect
from mobilecal_cli.commands.init import draft
from mobilecal_cli.errors import ConfigError, ObservationError, RecordingError
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.signals import CAMERA_INFO_CHANGES, CHAIN_LACKS, UNUSED
from mobilecal_cli.readers import open_recording
from mobilecal_cli.rig.config import UNCONFIGURED, load_rig
from mobilecal_cli.rig.resolve import complete_rig
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.scenario import Scenario
from tests.commands.edited import STORE, edited
from tests.pairs import with_pair
from tests.records import records_of, written

CAMERAS = ROBOTS["paper"].rig_cameras


def noted(other):
    """What is noted on a second recording with other cameras."""
    first, second = (SimpleNamespace(cameras=cameras) for cameras in (CAMERAS, other))
    return _other_cameras(SimpleNamespace(name="a.mcap", rig=first), "b.mcap", second)


def changed(**fields):
    return with_pair(CAMERAS, right=replace(CAMERAS.each[1], **fields))


@pytest.mark.parametrize(
    "other",
    [
        changed(K=CAMERAS.each[1].K * np.array([[1.001], [1.001], [1]])),
        changed(D=CAMERAS.each[1].D + 0.01),
        changed(D=np.zeros(8), distortion="rational_polynomial"),
        with_pair(CAMERAS, T_c_r=CAMERAS.T_c_each[1] + 1e-4),
    ],
)
def test_other_cameras_are_told(other):
    (note,) = noted(other)
    assert note.startswith(f"b.mcap: {CAMERA_INFO_CHANGES} from that of a.mcap")


def test_rounding_is_not_told():
    other = changed(K=CAMERAS.each[1].K * (1 + 1e-9), D=CAMERAS.each[1].D + 1e-9)
    assert noted(other) == ()


def test_the_recording_with_the_error_is_named(sample_logs):
    logs = [sample_logs / "imperfect_robot.mcap", sample_logs / "tick_robot.mcap"]
    said = r"imperfect_robot\.mcap: wheels\.left: the topic /wheel_ticks/left contains no messages"
    with pytest.raises(RecordingError, match=said):
        extract(logs, load_rig(sample_logs / "tick_robot.rig.yaml", {}))


def test_recordings_with_other_cameras_are_refused(sample_logs, tmp_path):
    left = [record for record in records_of(sample_logs / "straight.mcap") if "/right/" not in record.topic]
    log = written(tmp_path / "left.mcap", left)
    said = r"cameras of .*left\.mcap: camera; of .*paper_robot\.mcap: left, right"
    with pytest.raises(ConfigError, match=said):
        extract([sample_logs / "paper_robot.mcap", log], load_rig(None, {"board.square_m": 0.08}))


def test_a_note_on_one_of_several_recordings_names_it(sample_logs, tmp_path):
    """The head stands still in one, published once, and moves in the other."""
    sent = []

    def once(topic, message):
        if topic != "/joint_states":
            return message
        sent.append(topic)
        kept = [i for i, name in enumerate(message.name) if len(sent) == 1 or "wheel" in name]
        return replace(
            message, name=[message.name[i] for i in kept], position=message.position[np.array(kept)]
        )

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "still.mcap", once)
    extraction, _ = extract([sample_logs / "paper_robot.mcap", log], load_rig(None))
    said = "joint head_tilt_joint on /joint_states: one reading only; the joint counts as standing still"
    assert f"{log}: {said}" in extraction.notes
    assert not any(UNUSED in note for note in extraction.notes)


def test_a_recorded_joint_that_the_head_chain_lacks_is_noted(sample_logs):
    """`check` named it; `calibrate` sent its user to the floor."""
    pan = [{"joint": "head_pan_joint", "axis": [0, 0, 1]}]
    config = load_rig(
        None, {"head.base_frame": "base_link", "head.head_frame": "pan_link", "head.chain": pan}
    )
    extraction, _ = extract([sample_logs / "straight.mcap"], config)
    (note,) = (note for note in extraction.notes if CHAIN_LACKS in note)
    assert note.startswith(f"'head_tilt_joint': {CHAIN_LACKS} base_link to pan_link. Set head.head_frame to")


def test_joints_that_the_chain_lacks_are_named_together(sample_logs):
    """The hint had the same two sentences for each of them."""
    with open_recording([sample_logs / "straight.mcap"]) as recording:
        survey = describe(recording, load_rig(None, {"head.head_frame": "base_link"}))
    (error,) = wrong_chain(survey, complete_rig(survey))
    assert error.message.startswith("'head_pan_joint', 'head_tilt_joint': recorded, but not in")


def test_a_recording_of_which_nothing_is_used_is_named(sample_logs, tmp_path):
    """The first one alone decides, and would say nothing of the second."""

    _, wall = cv2.imencode(".jpg", np.full((480, 640), 90, dtype=np.uint8))

    def covered(topic, message):
        return replace(message, data=wall.ravel()) if "image" in topic else message

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "covered.mcap", covered)
    extraction, _ = extract([sample_logs / "paper_robot.mcap", log], load_rig(None))
    assert {o.log for o in extraction.observations} == {0}
    assert [note for note in extraction.notes if note.startswith(f"{log}: {UNUSED}")]


@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.long), -1])
def test_recordings_of_two_boards_are_refused(sample_logs, tmp_path, order):
    """The first one's board was used, and the other recording left out with a note."""
    simulate(Scenario(board=Board(7, 5, 0.09), stations=4, pictures_per_rest=1), tmp_path / "other.mcap")
    logs = [sample_logs / "paper_robot.mcap", tmp_path / "other.mcap"][::order]
    with pytest.raises(ObservationError) as caught:
        extract(logs, load_rig(None))
    (first, its), (other, size) = zip(logs, ("9 x 6", "7 x 5")[::order], strict=True)
    assert f"{first} one of {its} inner corners, {other} one of {size}" in caught.value.message


def test_a_refusal_notes_that_the_recording_is_cut_off(sample_logs, tmp_path):
    (tmp_path / "cut.mcap").write_bytes((sample_logs / "straight.mcap").read_bytes()[:60_000])
    with pytest.raises(RecordingError, match="has none on /stereo/right/image_raw/compressed") as caught:
        extract([tmp_path / "cut.mcap"], load_rig(None))
    assert caught.value.hint.count("; noted: ") == 1
    assert "the file ends inside a chunk at byte 47 of 60000" in caught.value.hint


def test_damage_is_noted(sample_logs, tmp_path):
    topic = "/stereo/left/image_raw/compressed"
    records = list(records_of(sample_logs / "paper_robot.mcap"))
    for number, record in list(enumerate(records))[len(records) // 2 :]:
        if record.topic == topic:
            message = replace(STORE.deserialize_cdr(record.data, record.type), data=np.zeros(4, np.uint8))
            records[number] = replace(record, data=bytes(STORE.serialize_cdr(message, record.type)))
    whole = written(tmp_path / "cut.mcap", records).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 85 // 100])
    extraction, _ = extract([tmp_path / "cut.mcap"], load_rig(None))
    assert any("the file ends inside a chunk" in note for note in extraction.notes)
    (note,) = (note for note in extraction.notes if "images cannot be decoded" in note)
    assert f"such as one on {topic}: image damaged, or not JPEG or PNG: 4 bytes" in note


@pytest.mark.long
def test_another_board_than_the_stated_one_is_named(sample_logs):
    stated = load_rig(None, {"board.columns": 8, "board.rows": 6})
    with pytest.raises(ObservationError, match="8 x 6 inner corners, but the images show 9 x 6") as caught:
        extract([sample_logs / "straight.mcap"], stated)
    assert "--board 9x6" in caught.value.hint


@pytest.mark.parametrize(
    ("size", "covered"), [((6, 6), True), ((6, 7), True), ((11, 8), False), ((7, 7), False)]
)
def test_a_board_that_is_covered_in_part_may_look_like_a_smaller_one(size, covered):
    assert other_size(Board(9, 6), size).hint.startswith("uncover") is covered


def beside(source, target, topic, factor, wheels_rad=0.0):
    """A recording with its joint states on a second topic, times a factor; wheels count from another zero."""

    def second(record):
        message = STORE.deserialize_cdr(record.data, record.type)
        zero = wheels_rad * np.array(["wheel" in name for name in message.name])
        message = replace(message, position=factor * message.position + zero)
        data = bytes(STORE.serialize_cdr(message, record.type))
        return replace(record, topic=topic, time_ns=record.time_ns + 5_000_000, data=data)

    records = list(records_of(source))
    more = [second(record) for record in records if record.topic == "/joint_states"]
    return written(target, sorted([*records, *more], key=lambda record: record.time_ns))


@pytest.mark.parametrize(
    ("topic", "factor", "why"),
    [
        ("/base/joint_states", 0.0, "they stand still"),
        (
            "/zz/joint_states",
            np.nan,
            "all 2142 readings are not possible, such as nan (range -1e+09 to 1e+09)",
        ),
    ],
)
def test_a_second_topic_that_says_nothing_is_not_read(sample_logs, tmp_path, topic, factor, why, few):
    """The topic whose name came first was read: the board was "found at 0 of 1 stations"."""
    log = beside(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", topic, factor)
    with open_recording([log]) as recording:
        survey = describe(recording, UNCONFIGURED)
        (note,) = recording.damage
    assert "Joints head_pan_joint, head_tilt_joint" in note
    assert f"wheel_right_joint: read on /joint_states, not on {topic}, where {why}." in note
    assert survey.lacks == []
    assert survey.sources.joint_topics == ["/joint_states"]
    assert {wheel.topic for wheel in survey.sources.wheels.values()} == {"/joint_states"}
    found = inspect([log])
    assert found.missing == found.weak == ()
    assert found.notes == draft([log]).notes == (note,)


def with_wheels(records, moving=False, odometry="drives"):
    """Records with wheels in the joint states, and with odometry that drives, stands or is not there."""
    for number, record in enumerate(records):
        if record.topic in ("/joint_states", "/odom"):
            message = STORE.deserialize_cdr(record.data, record.type)
            if record.topic == "/joint_states":
                wheels, turned = ["left_wheel_joint", "right_wheel_joint"], [0.01 * number * moving] * 2
                position = np.append(message.position, turned)
                message = replace(message, name=[*message.name, *wheels], position=position)
            elif odometry == "stands":
                place, turn = message.pose.pose.position, message.pose.pose.orientation
                place.x = place.y = turn.z = 0.0
                turn.w = 1.0
            record = replace(record, data=bytes(STORE.serialize_cdr(message, record.type)))
        if odometry or record.topic != "/odom":
            yield record


def wheels_of(log, earlier=None):
    """Survey of a recording, topics of its wheels, and whether a note says that joints are not read as wheels."""
    with open_recording([log]) as recording:
        survey = describe(recording, load_rig(None, {"board.square_m": 0.08}), earlier=earlier)
        said = any(
            "Joints left_wheel_joint, right_wheel_joint: not read" in note for note in recording.damage
        )
    return survey.description, {wheel.topic for wheel in survey.sources.wheels.values()}, said


@pytest.mark.parametrize("odometry", ["drives", "stands", ""])
def test_wheels_that_never_move_are_not_read_where_there_are_others(sample_logs, tmp_path, odometry):
    """Those of a joint_state_publisher: "1 x board or robot moved during the stop", it said."""
    records = with_wheels(records_of(sample_logs / "rgbd_odometry.mcap"), odometry=odometry)
    _, topics, said = wheels_of(written(tmp_path / "log.mcap", records))
    assert topics == {"/odom" if odometry == "drives" else "/joint_states"}
    assert said is (odometry == "drives")


@pytest.mark.parametrize(("moving", "topic"), [(True, "/joint_states"), (False, "/odom")])
def test_the_wheels_of_further_recordings_are_those_of_the_first(sample_logs, tmp_path, moving, topic):
    """Where the base stood in the first one: "the radius multiplier is 2.231", of rotations that were read as odometry."""
    earlier = None
    for stands in (not moving, moving):
        records = with_wheels(records_of(sample_logs / "rgbd_odometry.mcap"), not stands)
        earlier, topics, said = wheels_of(written(tmp_path / f"{stands}.mcap", records), earlier)
        assert (topics, said) == ({topic}, topic == "/odom")


def test_log_times_that_are_all_zero_are_no_other_topic(sample_logs, tmp_path):
    """ "Different readings on /joint_states and on /joint_states", it said: at one log time, they differ."""
    records = (replace(each, time_ns=0) for each in records_of(sample_logs / "paper_robot.mcap"))
    log = written(tmp_path / "log.mcap", records)
    times = []
    for each in (sample_logs / "paper_robot.mcap", log):
        with open_recording([each]) as recording:
            (plan,), *_ = plan_recording(recording, complete_rig(describe(recording, UNCONFIGURED)))
            times.append([station.time_ns for station in plan.stations])
    assert times[0] == times[1]


def test_a_description_that_cannot_be_read_is_not_missing(sample_logs, tmp_path):
    """ "No robot_description in the recording", it said."""

    def cut(record):
        return (
            replace(record, data=record.data[: len(record.data) // 2])
            if "description" in record.topic
            else record
        )

    log = written(tmp_path / "log.mcap", map(cut, records_of(sample_logs / "paper_robot.mcap")))
    with pytest.raises(
        RecordingError, match="unknown: /robot_description is empty or cannot be read, no transforms"
    ):
        extract([log], UNCONFIGURED)


def test_topics_that_contradict_each_other(sample_logs, tmp_path, few):
    log = beside(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", "/base/joint_states", 0.5)
    said = "joint head_pan_joint has different readings on /base/joint_states and on /joint_states"
    with pytest.raises(RecordingError, match=said) as caught:
        extract([log], UNCONFIGURED)
    assert "set joints.topic" in caught.value.hint
    assert [lack.key for lack in draft([log]).todo if lack.needed] == ["wheels", "joints.topic"]
    topics = {"joints.topic": "/joint_states"}
    (lack,) = inspect([log], load_rig(None, topics)).missing
    assert "joint wheel_left_joint has different readings" in lack.what
    assert "set wheels.left.topic and wheels.right.topic" in lack.cure
    topics |= {f"wheels.{side}.topic": "/joint_states" for side in ("left", "right")}
    assert inspect([log], load_rig(None, topics)).missing == ()


@pytest.mark.parametrize("wheels_rad", [0.0, 1.7])
def test_topics_that_agree(sample_logs, tmp_path, few, wheels_rad):
    """Wheels also if they count from another zero: only their rotations mean something."""
    log = beside(
        sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", "/base/joint_states", 1.0, wheels_rad
    )
    found = inspect([log])
    assert found.missing == found.weak == found.notes == ()
