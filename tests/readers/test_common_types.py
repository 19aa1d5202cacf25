"""The message types that the readers rely on, against those that rosbags ships."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobilecal_cli.readers.messages.types import agrees

ROS2 = (Stores.ROS2_FOXY, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY)


@pytest.mark.parametrize("release", ROS2)
def test_they_are_those_of_ros_2(release):
    store = get_typestore(release)
    assert agrees(store, "cdr")
    assert not agrees(store, "ros1")


def test_they_are_those_of_ros_1_and_no_others():
    store = get_typestore(Stores.ROS1_NOETIC)
    assert agrees(store, "ros1")
    assert not agrees(store, "cdr")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("string[<=5] data", "mine/msg/String"))
    assert agrees(store, "cdr")


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
    ],
)
def test_a_definition_that_differs_does_not_agree(definition):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, "std_msgs/msg/String"))
    assert not agrees(store, "cdr")
