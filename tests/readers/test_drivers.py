"""Encoder messages of well-known robots, by field path; their definitions stand in the recording."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobilecal_cli.model import Sources, WheelSource
from mobilecal_cli.readers import open_recording

from . import recordings as r

#: Type, its definition as the driver's package has it (shortened to what a driver needs), and the wheels' fields.
DRIVERS = {
    "kobuki": (
        "kobuki_ros_interfaces/msg/SensorState",
        "uint8 BUMPER_RIGHT=1\nstd_msgs/Header header\nuint16 time_stamp\nuint8 bumper\nuint16 left_encoder\n"
        "uint16 right_encoder\nint8 left_pwm\nuint16[] bottom\n",
        ("left_encoder", "right_encoder"),
        (16, 2578.33),
    ),
    "turtlebot3": (
        "turtlebot3_msgs/msg/SensorState",
        "std_msgs/Header header\nuint8 bumper\nfloat32 illumination\nint32 left_encoder\nint32 right_encoder\nfloat32 battery\n",
        ("left_encoder", "right_encoder"),
        (32, 4096),
    ),
    "husky": (
        "husky_msgs/msg/Encoders",
        "std_msgs/Header header\nhusky_msgs/Encoder[] encoders\n" + "=" * 80 + "\nMSG: husky_msgs/Encoder\n"
        "float64 travel\nfloat64 speed\n",
        ("encoders[0].travel", "encoders[1].travel"),
        (None, 2 * np.pi),
    ),
}


def value(kind, store, left, right, stamp_ns):
    """A message with the two wheels' readings, all other fields 0."""
    fields = {}
    for name, (node, _) in store.fielddefs[kind][1]:
        if name == "header":
            fields[name] = r.header(store, stamp_ns)
        elif name == "encoders":
            inner = store.types["husky_msgs/msg/Encoder"]
            fields[name] = [inner(left, 0.0), inner(right, 0.0)]
        elif name in ("left_encoder", "right_encoder"):
            fields[name] = left if name.startswith("left") else right
        else:
            fields[name] = np.zeros(0, np.uint16) if node.name == "SEQUENCE" else 0
    return store.types[kind](**fields)


@pytest.mark.parametrize("driver", DRIVERS)
def test_wheels_by_field_path(driver, tmp_path):
    kind, definition, paths, (bits, per_turn) = DRIVERS[driver]
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(definition, kind))
    turns = np.linspace(0, 40, 60)
    messages = []
    for k, turn in enumerate(turns):
        stamp = r.START_NS + k * r.STEP_NS
        left, right = turn * per_turn, -turn * per_turn
        if bits:
            low = -(2**31) if bits == 32 else 0
            left, right = ((round(v) + 60_000 - low) % 2**bits + low for v in (left, right))
        data = bytes(store.serialize_cdr(value(kind, store, left, right, stamp), kind))
        messages.append(r.Raw("/sensors", stamp + 5, data, r.schema_of(store, kind)))
    r.write_raw(tmp_path / "log.mcap", messages)
    counters = (
        WheelSource("/sensors", field=path, ticks_per_revolution=per_turn, bits=bits) for path in paths
    )
    wheels = dict(zip(("left", "right"), counters, strict=True))
    with open_recording([tmp_path / "log.mcap"]) as recording:
        signals = r.one_log(recording, Sources({}, {}, (), wheels), ())
    np.testing.assert_array_equal(signals.wheels["left"].time_ns, r.START_NS + np.arange(60) * r.STEP_NS)
    for side, sign in (("left", 1), ("right", -1)):
        found = signals.wheels[side].value
        np.testing.assert_allclose(found - found[0], sign * 2 * np.pi * turns, atol=2 * np.pi / per_turn)
