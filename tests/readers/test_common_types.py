"""The message types that the readers rely on, against those that rosbags ships."""

import pytest
from rosbags.typesys import Stores, get_typestore

from mobilecal_cli.readers.messages.types import core_types, ros_decoder


@pytest.mark.parametrize(
    "release", [Stores.ROS1_NOETIC, Stores.ROS2_FOXY, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY]
)
def test_they_are_those_of_ros(release):
    stored = get_typestore(release).fielddefs
    for name, (_, fields) in core_types("ros1" if release is Stores.ROS1_NOETIC else "cdr").items():
        # ROS 1 names a camera's matrices D, K, R, P, ROS 2 d, k, r, p.
        assert [(f.lower() if len(f) == 1 else f, kind) for f, kind in stored[name][1]] == fields


@pytest.mark.parametrize(
    "definition",
    [
        "float64[] data",  # another type
        "string[] data",
        "string[1] data",
        "string<=5 data",
        "string[<=5] data",
        "string text",
        "string data\nstring more",
        "builtin_interfaces/Time data",
        "\0",
    ],
)
def test_a_definition_that_differs_is_not_used(definition):
    decode = ros_decoder("cdr", "std_msgs/msg/String", definition, "msg")
    assert decode(b"\0\1\0\0\2\0\0\0a\0").data == "a"
