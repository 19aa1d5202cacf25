"""Calibrations, names and URDFs from a recording's first messages."""

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers import open_recording, read_description
from mobilecal_cli.readers.containers.mcap import McapStorage
from mobilecal_cli.readers.signals.camera_infos import camera_info

from . import recordings as r

K = r.K_LEFT
P = np.array([[480.0, 0, 310, -57.6], [0, 480, 235, 0], [0, 0, 1, 0]])
STORES = pytest.mark.parametrize("store", [r.ROS1, r.ROS2], ids=["ros1", "ros2"])


@STORES
def test_binning_and_region_as_image_geometry(store):
    message = r.info(K, [0.1, 0, 0, 0, 0], P, size=(640, 480), binning=(2, 4), roi=(100, 40, 400, 320))(store)
    found = camera_info(message, "/info")
    assert (found.width, found.height) == (200, 80)
    np.testing.assert_allclose(found.K, [[250, 0, 110], [0, 127.5, 50], [0, 0, 1]])
    np.testing.assert_allclose(found.P, [[240, 0, 105, -28.8], [0, 120, 48.75, 0], [0, 0, 1, 0]])
    np.testing.assert_array_equal(found.D, [0.1, 0, 0, 0, 0])
    found = camera_info(r.info(K, P=P, R=np.diag([1, -1, -1]))(store), "/info")
    np.testing.assert_array_equal(found.K, K)
    np.testing.assert_array_equal(found.P, P)
    np.testing.assert_array_equal(found.R, np.diag([1, -1, -1]))
    assert (found.width, found.height, found.frame_id) == (640, 480, "left_optical")


@STORES
def test_a_frame_may_have_a_slash_at_its_front(store):
    """As in tf before tf2, whose transforms were read without it."""
    message = r.info(K)(store)
    message.header.frame_id = "/left_optical"
    assert camera_info(message, "/info").frame_id == "left_optical"


@pytest.mark.parametrize(
    ("name", "D", "model", "count"),
    [
        ("plumb_bob", [0.1, 0.2, 0, 0, 0.3], "plumb_bob", 5),
        ("plumb_bob", [0.1, 0.2, 0, 0], "plumb_bob", 5),
        ("plumb_bob", [], "none", 0),
        ("", [], "none", 0),
        ("", [0, 0, 0, 0, 0], "none", 0),
        ("", [0.1, 0, 0, 0, 0], "plumb_bob", 5),
        ("plumb_bob", [0.1] * 8, "rational_polynomial", 8),
        ("rational_polynomial", [0.1] * 8, "rational_polynomial", 8),
        ("rational_polynomial", [0.1] * 5, "rational_polynomial", 8),
        ("rational_polynomial", [0.1] * 12, "rational_polynomial", 12),
        ("rational_polynomial", [0.1] * 14, "rational_polynomial", 14),
        ("equidistant", [0.1] * 4, "equidistant", 4),
        ("fisheye", [0.1] * 4, "equidistant", 4),
        ("Kannala_Brandt4", [0, 0, 0, 0], "equidistant", 4),
        ("equidistant", [0.1, 0.1, 0.1, 0.1, 0], "equidistant", 4),
    ],
)
def test_distortion_models(name, D, model, count):
    found = camera_info(r.info(K, D, model=name)(r.ROS2), "/info")
    assert (found.distortion, len(found.D)) == (model, count)
    np.testing.assert_array_equal(found.D[: len(D)], D[:count])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"K": np.zeros((3, 3))}, "/info: K is all zeros: the camera is not calibrated"),
        ({"K": np.where(K, np.nan, 0)}, "/info: K contains values that are not finite"),
        ({"K": K, "P": np.where(P, np.inf, 0)}, "/info: P contains values that are not finite"),
        ({"K": K, "D": [np.nan]}, "/info: D contains values that are not finite"),
        ({"K": -K}, "/info: K has no positive focal lengths"),
        ({"K": K, "D": [1, 2], "model": "omnidirectional"}, "unknown distortion model 'omnidirectional'"),
        ({"K": K, "D": [1, 2], "model": "equidistant"}, "2 distortion coefficients do not match"),
        ({"K": K, "D": [1] * 15}, "15 distortion coefficients do not match"),
    ],
)
def test_calibrations_that_are_none_are_refused(arguments, message):
    with pytest.raises(RecordingError, match=message) as caught:
        camera_info(r.info(**arguments)(r.ROS2), "/info")
    assert "calibrate the camera" in caught.value.hint


def test_many_topics_are_read_in_one_pass(tmp_path, monkeypatch):
    """Each topic has fewer messages than are wanted. The channels are not gone through again for every topic."""

    class Counted(dict):
        passes = 0

        def values(self):
            Counted.passes += 1
            return super().values()

    items = [
        r.Item(f"/robot{n}/joint_states", r.START_NS + k, r.joint_state([f"a{n}", f"b{k}"], [1.0, 2.0]))
        for k in range(3)
        for n in range(40)
    ]
    path = r.write_mcap(tmp_path / "log.mcap", items, chunk_size=1000)
    loads = []
    load = McapStorage.load
    monkeypatch.setattr(McapStorage, "load", lambda self, block: loads.append(block) or load(self, block))
    with open_recording([path]) as recording:
        (storage,) = recording.parts
        blocks = len(storage.blocks)
        assert blocks > 10
        loads.clear()
        storage.channels = Counted(storage.channels)
        names = read_description(recording).joint_names
    assert names == {f"/robot{n}/joint_states": (f"a{n}", "b0", "b1", "b2") for n in range(40)}
    assert len(loads) == blocks
    assert Counted.passes < 20


def test_a_semantic_description_is_no_urdf(tmp_path):
    semantic = "<robot name='r'><group name='arm'><joint name='pan'/></group></robot>"
    texts = {"/a/robot_description": r.URDF, "/robot_description_semantic": semantic}
    items = [r.Item(topic, r.START_NS, r.number("String", text)) for topic, text in texts.items()]
    with open_recording([r.write_mcap(tmp_path / "log.mcap", items)]) as recording:
        assert read_description(recording).urdfs == {"/a/robot_description": r.URDF}


def test_joint_names_of_drivers_that_take_turns(tmp_path):
    names = [["pan", "tilt"], ["wheel_left"], ["wheel_right"]]
    items = [r.Item("/j", r.START_NS + k, r.joint_state(names[k % 3], [0.0] * 2)) for k in range(200)]
    path = r.write_mcap(tmp_path / "log.mcap", items)
    with open_recording([path]) as recording:
        assert read_description(recording).joint_names == {"/j": ("pan", "tilt", "wheel_left", "wheel_right")}
    path = r.write_mcap(tmp_path / "log.mcap", [])
    with open_recording([path]) as recording, pytest.raises(RecordingError, match="contains no messages"):
        read_description(recording)


@pytest.mark.parametrize("name", ["mcap-zstd", "mcap-no-summary", "bag"])
def test_long_recording_is_not_read_to_its_end(tmp_path, monkeypatch, name):
    path = r.CONTAINERS[name](tmp_path / "log", r.world(600))
    with open_recording([path]) as recording:
        part = recording.parts[0]
        loaded = set()
        load = part.load
        monkeypatch.setattr(part, "load", lambda block: loaded.add(block.offset) or load(block))
        read_description(recording)
        assert len(part.blocks) > 10
        assert len(loaded) < len(part.blocks) / 4
