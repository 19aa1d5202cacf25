"""Wheel rotations out of odometry."""

import math

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources, WheelGeometry, WheelSource
from mobilecal_cli.model.signals import TURNS_AT_REST, Track
from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.signals.wheels import (
    Odometry,
    gap_notes,
)

from . import recordings as r

WHEELS = WheelGeometry(0.1, 0.2, 0.5)


def times(pose):
    return np.arange(len(pose)) * r.STEP_NS


def test_straight_on_by_hand():
    """One metre along a heading of 90 degrees: 10 rad of the wheel of 0.1 m, 5 rad of that of 0.2 m."""
    pose = np.column_stack([np.ones(5), np.linspace(1, 2, 5), np.full(5, math.pi / 2)])
    right, left, jumps = Odometry("/odom", times(pose), pose).rotations(WHEELS)
    assert (right[-1], left[-1], jumps.any()) == (pytest.approx(10), pytest.approx(5), False)


def test_backwards_on_the_spot_and_round_by_hand():
    """Back by 0.1 m; 1 rad to the left on the spot; a quarter circle of radius 1 m to the left."""
    back, turned = np.array([[[0, 0, 0], [-0.1, 0, 0]], [[0, 0, 3.0], [0, 0, 4.0 - 2 * math.pi]]])
    assert Odometry("/odom", times(back), back).rotations(WHEELS)[0][-1] == pytest.approx(-1)
    right, left, _ = Odometry("/odom", times(turned), turned).rotations(WHEELS)
    assert (right[-1], left[-1]) == (pytest.approx(2.5), pytest.approx(-1.25))
    at = np.linspace(0, math.pi / 2, 10)
    arc = np.stack([np.sin(at), 1 - np.cos(at), at], axis=1)
    right, left, _ = Odometry("/odom", times(arc), arc).rotations(WHEELS)
    assert right[-1] == pytest.approx(math.pi / 2 * 1.25 / 0.1)
    assert left[-1] == pytest.approx(math.pi / 2 * 0.75 / 0.2)


def test_a_reset_of_the_driver_is_the_motion_around_it(tmp_path):
    xs = [0.0, 0.1, 0.2, 0.0, 0.1, 5.1, 5.2]  # m: 20 cm back between two messages may be true, 5 m are not

    def odometry(i, x):
        header = {"stamp": {"sec": 9, "nanosec": i * 1000}, "frame_id": "odom"}
        upright = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        pose = {"pose": {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": upright}}
        return ("/odom", r.START_NS + i * r.STEP_NS, "nav_msgs/Odometry", {"header": header, "pose": pose})

    path = r.write_json(tmp_path / "log.mcap", (odometry(i, x) for i, x in enumerate(xs)))
    source = WheelSource("/odom", baked_in=WHEELS)
    with open_recording([path]) as recording:
        assert recording.topic("/odom").type == "nav_msgs/msg/Odometry"
        sources = Sources({}, {}, {}, {"left": source, "right": source})
        signals = r.one_log(recording, sources)
    assert signals.wheels["right"].value == pytest.approx([0, 1, 2, 0, 1, 2, 3])
    assert signals.wheels["left"].time_ns.tolist() == [9_000_000_000 + i * 1000 for i in range(7)]
    sizes = "wheel radii of 200 mm (left) and 100 mm (right) and a separation of 500 mm"
    assert any(sizes in note for note in signals.notes)
    assert any(
        "right wheel of the pose on /odom: the rotation jumps once by 50 rad" in note
        for note in signals.notes
    )


def test_positions_in_millimeters_are_named():
    time_ns, way_m = np.arange(5) * 20_000_000, np.array([0, 0, 0.006, 0.012, 0.018])
    pose = np.stack([way_m, np.zeros(5), np.zeros(5)], axis=1)
    Odometry("/odom", time_ns, pose).check_speed()
    with pytest.raises(RecordingError, match=r"/odom: the odometry drives at 300 m/s \(limit 20 m/s\)"):
        Odometry("/odom", time_ns, 1e3 * pose).check_speed()
    Odometry("/odom", time_ns, np.zeros((5, 3))).check_speed()
    Odometry("/odom", time_ns[:1], pose[:1]).check_speed()


def drive(rate_hz, offset_m=0.0, seconds=30):
    """Stamps, and poses of a differential drive whose base frame is `offset_m` ahead of the axle."""
    time_ns = np.arange(seconds * rate_hz) * 10**9 // rate_hz
    at_s, way_m = time_ns * 1e-9, np.full(len(time_ns), 0.3 / rate_hz)
    heading = np.sin(0.5 * at_s)
    x, y = np.cumsum(way_m * np.cos(heading)), np.cumsum(way_m * np.sin(heading))
    return time_ns, np.stack(
        [x + offset_m * np.cos(heading), y + offset_m * np.sin(heading), heading], axis=1
    )


@pytest.mark.parametrize("rate_hz", [10, 50])
def test_odometry_that_jumps_follows_more_than_the_wheels(rate_hz):
    """Corrections of 0.36 m every 6 s: the first one beside 30 or 6 mm of motion."""
    time_ns, pose = drive(rate_hz)
    corrections = (time_ns // (6 * 10**9))[:, None] * [-0.2, 0.3, 0.0]
    with pytest.raises(RecordingError, match=r"4 times, first by 0.3\d m 6.0 s after the start") as told:
        Odometry("/odom", time_ns, pose + corrections).check_forward()
    assert told.value.hint.startswith("record the odometry of the wheels alone, not one that a filter")
    with pytest.raises(RecordingError, match=r"from one message to the next, once by 0\.4\d m"):
        Odometry("/odom", time_ns[: 7 * rate_hz], (pose + 1.2 * corrections)[: 7 * rate_hz]).check_forward()


@pytest.mark.parametrize(("speed", "pause_s"), [(1, 1.5), (1, 3), (0.3, 4)])
def test_a_pause_is_no_jump_and_no_motion_sideways(speed, pause_s):
    """Pauses were refused ("jumps sideways from one message to the next"), or the wheels stood still during them."""
    time_ns, pose = drive(50, offset_m=0.1)
    pose *= [speed, speed, 1]
    told = time_ns % (8 * 10**9) >= pause_s * 10**9
    offsets_m = (
        Odometry("/odom", time_ns[told], pose[told]).check_forward(),
        Odometry("/odom", time_ns, pose).check_forward(),
    )
    assert offsets_m == pytest.approx((0.1 * speed, 0.1 * speed), rel=0.05)
    right, left, jumps = Odometry("/odom", time_ns[told], pose[told]).rotations(WHEELS)
    assert not jumps.any()
    for wheel in (right, left):
        assert "3 gaps during which the wheel turned" in gap_notes("wheel", Track(time_ns[told], wheel))[0]


@pytest.mark.parametrize("mirrored", [[1, -1, 1], [1, 1, -1], [-1, 1, 1]])
def test_the_sign_of_one_axis_is_named(mirrored):
    time_ns, pose = drive(50, offset_m=0.1)
    assert Odometry("/odom", time_ns, pose).check_forward() == pytest.approx(0.1, abs=5e-3)
    with pytest.raises(RecordingError, match="not with the sign of y reversed: the y axis of its positions"):
        Odometry("/odom", time_ns, pose * mirrored).check_forward()


def test_motion_sideways_is_that_of_another_drive():
    time_ns, pose = drive(50)
    pose[:, 1] += 0.3 * np.sin(time_ns * 1e-9)
    with pytest.raises(RecordingError, match="m ahead: a differential drive cannot") as told:
        Odometry("/odom", time_ns, pose).check_forward()
    assert told.value.hint.startswith("mecanum and other omnidirectional robots")


def test_rounding_is_no_motion_sideways():
    """Positions in whole centimeters, fifty a second, were those of a mecanum drive."""
    time_ns, pose = drive(50)
    assert Odometry("/odom", time_ns, np.round(pose, 2)).check_forward() == 0


def test_a_heading_that_never_changes_is_named():
    """A driver that leaves the orientation empty was that of a mecanum drive, too."""
    time_ns, pose = drive(50)
    with pytest.raises(RecordingError, match=r"sideways, .* and its heading never changes"):
        Odometry("/odom", time_ns, pose * [1, 1, 0]).check_forward()


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_poses_that_never_change_while_the_robot_drives_are_named(tmp_path, speed):
    """Of a driver that publishes the twist alone: "the board was found at 0 of 1 stations", and how to light it."""
    pose = {
        "pose": {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    }
    twist = {"twist": {"linear": {"x": speed, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}}
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "odom"}
    message = {"header": header, "pose": pose, "twist": twist}
    items = [("/odom", r.START_NS + i * r.STEP_NS, "nav_msgs/Odometry", message) for i in range(5)]
    source = WheelSource("/odom", baked_in=WHEELS)
    with open_recording([r.write_json(tmp_path / "log.mcap", items)]) as recording:
        sources = Sources({}, {}, {}, {"left": source, "right": source})
        if not speed:
            assert not r.one_log(recording, sources).wheels["left"].value.any()
            return
        with pytest.raises(RecordingError, match=r"^/odom: all 5 poses of the odometry are the same") as told:
            r.one_log(recording, sources)
    assert "publish the poses, not the twist alone" in told.value.hint


def test_a_heading_that_changes_at_rest_is_that_of_a_gyro():
    """A gyro's scale was taken for that of the wheels: a multiplier was off by 22 of its sigmas, with a PASS."""
    time_ns = np.arange(0, 40 * 10**9, 20 * 10**6)
    drives = (time_ns // (2 * 10**9)) % 2 == 1
    way, heading = (np.cumsum(np.where(drives, step, 0.0)) for step in (0.004, 0.01))
    pose = np.stack([way, np.zeros(len(way)), heading], axis=1)
    assert Odometry("/odom", time_ns, pose).turns_at_rest() == []
    drifting = pose + np.radians(1.5 / 60) * 1e-9 * time_ns[:, None] * [0, 0, 1]
    assert Odometry("/odom", time_ns, drifting).turns_at_rest() == [
        f"/odom: {TURNS_AT_REST}, by 1.5 degrees per minute"
    ]
    turning = np.where(drives, 0.0, pose[:, 0])[:, None] * [0, 0, 1]  # in place
    assert Odometry("/odom", time_ns, turning).turns_at_rest() == []
