"""Joint readings out of /tf."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import JointTransform, Sources, WheelSource
from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.signals.joints import reading

from . import recordings as r

ORIGIN = se3.transform(Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(), np.array([0.1, 0.2, 0.3]))
AXIS = np.array([0.0, 0.6, 0.8])
PAN = JointTransform("/tf", "torso", "neck", ORIGIN, AXIS, "revolute")
LIFT = JointTransform("/tf", "base_link", "torso", np.eye(4), np.array([0.0, 0.0, 1.0]), "prismatic")


def moved(source, value):
    """The transform of a joint's link, by another library than the reader's."""
    turn, way = Rotation.identity(), source.axis * value
    if source.kind == "revolute":
        turn, way = Rotation.from_rotvec(value * source.axis), np.zeros(3)
    rotation = Rotation.from_matrix(source.T_parent_child[:3, :3])
    place = source.T_parent_child[:3, 3] + rotation.apply(way)
    return place, (rotation * turn).as_quat()


def fields_of(place, quaternion):
    """A geometry_msgs/Transform, as JSON has it."""
    translation, rotation = (dict(zip("xyzw", v.tolist(), strict=False)) for v in (place, quaternion))
    return {"translation": translation, "rotation": rotation}


def as_message(place, quaternion):
    """A geometry_msgs/Transform."""
    return SimpleNamespace(**{k: SimpleNamespace(**v) for k, v in fields_of(place, quaternion).items()})


@pytest.mark.parametrize("value", [0.0, 0.4, -1.5, 3.1, -3.1])
def test_a_turning_joint(value):
    angle, off_rad, off_m = reading(PAN, as_message(*moved(PAN, value)))
    assert angle == pytest.approx(value, abs=1e-12)
    assert max(off_rad, off_m) < 1e-7


def test_a_sliding_joint_and_what_does_not_fit():
    assert reading(LIFT, as_message(*moved(LIFT, 0.25))) == pytest.approx((0.25, 0, 0))
    place, _ = moved(PAN, 0.0)
    turned = Rotation.from_matrix(ORIGIN[:3, :3]) * Rotation.from_rotvec([0.3, 0, 0])
    angle, off_rad, off_m = reading(PAN, as_message(place + np.array([0.0, 0.03, 0.04]), turned.as_quat()))
    assert (angle, off_rad, off_m) == pytest.approx((0, 0.3, 0.05))


def tf_message(i, *frames):
    transforms = []
    for parent, child, (place, quaternion) in frames:
        header = {"stamp": {"sec": 5, "nanosec": 1000 * i}, "frame_id": parent}
        transform = fields_of(place, quaternion)
        transforms.append({"header": header, "child_frame_id": child, "transform": transform})
    return ("/tf", r.START_NS + i * r.STEP_NS, "tf2_msgs/TFMessage", {"transforms": transforms})


def signals_of(folder, messages, sources):
    counts = [("/count", r.START_NS + i, "std_msgs/Int32", {"data": 7}) for i in range(2)]
    path = r.write_json(folder / "log.mcap", [*messages, *counts])
    wheels = dict.fromkeys(("left", "right"), WheelSource("/count", field="data"))
    with open_recording([path]) as recording:
        return r.one_log(recording, Sources({}, {}, sources, wheels))


def test_joints_over_time_with_their_own_stamps(tmp_path):
    """One message holds both joints and a stranger; the pan goes beyond half a turn."""
    pan = np.linspace(2.0, 4.0, 9)
    lift = np.linspace(0, 0.2, 9)
    stranger = ("map", "odom", moved(LIFT, 1.0))
    neck = [("/torso", "neck", moved(PAN, angle)) for angle in pan]
    torso = [("base_link", "torso", moved(LIFT, height)) for height in lift]
    messages = [tf_message(i, neck[i], stranger, torso[i]) for i in range(9)]
    found = signals_of(tmp_path, messages, {"pan": PAN, "lift": LIFT})
    assert found.joints["pan"].value == pytest.approx(pan)
    assert found.joints["lift"].value == pytest.approx(lift)
    assert found.joints["pan"].time_ns.tolist() == [5_000_000_000 + 1000 * i for i in range(9)]
    assert "joint pan on /tf: read from the transform from torso to neck" in found.notes


def test_transforms_of_another_robot(tmp_path):
    strangers = [tf_message(i, ("map", "odom", moved(LIFT, 0.1))) for i in range(3)]
    with pytest.raises(RecordingError, match=r"no transform from torso to neck.*present: map to odom"):
        signals_of(tmp_path, strangers, {"pan": PAN})
    skewed = [tf_message(i, ("torso", "neck", moved(LIFT, 0.1 * i))) for i in range(3)]
    with pytest.raises(RecordingError, match=r"deviates from joint pan by up to .* degrees and .* mm"):
        signals_of(tmp_path, skewed, {"pan": PAN})
