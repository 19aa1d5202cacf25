"""Export formats and paper sizes, in a module that imports nothing heavy, for the command line."""

from __future__ import annotations

from enum import StrEnum


class Target(StrEnum):
    """A format of `mobilecal export`."""

    urdf = "urdf"
    xacro = "xacro"
    ros2_control = "ros2_control"
    static_transform_launch = "static_transform_launch"
    static_transform_yaml = "static_transform_yaml"
    camera_info_left = "camera_info_left"
    camera_info_right = "camera_info_right"
    camchain = "camchain"
    odometry_covariance = "odometry_covariance"
    foxglove = "foxglove"
    json = "json"


#: Option of `mobilecal export` → the formats that use it.
OPTIONS: dict[str, tuple[Target, ...]] = {
    "--urdf": (Target.urdf,),
    "--left-joint": (Target.urdf, Target.ros2_control),
    "--right-joint": (Target.urdf, Target.ros2_control),
    "--with-chain": (Target.urdf,),
    "--rate": (Target.odometry_covariance,),
    "--distance": (Target.odometry_covariance,),
    "--log": (Target.foxglove,),
}


class Paper(StrEnum):
    """A page of `mobilecal board`: automatic (A4 to A0), a standard size, or as large as the board needs."""

    auto = "auto"
    a4 = "a4"
    a3 = "a3"
    a2 = "a2"
    a1 = "a1"
    a0 = "a0"
    letter = "letter"
    tabloid = "tabloid"
    ansi_c = "ansi_c"
    ansi_d = "ansi_d"
    ansi_e = "ansi_e"
    exact = "exact"
