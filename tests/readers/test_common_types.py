"""The message types that the readers rely on, against those that rosbags ships."""

import pytest
from rosbags.typesys import Stores, get_typestore

from mobilecal_cli.readers.messages.types import CORE, ros_decoder


@pytest.mark.parametrize("release", [Stores.ROS2_FOXY, Stores.ROS2_JAZZY])
def test_they_are_those_of_every_release(release):
    stored, usual = (get_typestore(each).fielddefs for each in (release, Stores.ROS2_HUMBLE))
    assert {name: stored[name] for name in CORE} == {name: usual[name] for name in CORE}


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
