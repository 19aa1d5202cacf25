"""The description of a robot in a recording, with the numbers that its wheels or joints may be."""

from __future__ import annotations

from dataclasses import replace

from mobilecal_cli.model import (
    CAMERA_INFO,
    IMAGES,
    JOINT_STATE,
    ODOMETRY,
    STRING,
    TRANSFORMS,
    RobotDescription,
)
from mobilecal_cli.readers import Recording, number_fields, read_description
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.names import may_be_a_reading
from mobilecal_cli.rig.resolve import Survey, survey_rig
from mobilecal_cli.rig.wheels import needs_numbers

#: Types that are read by their meaning, not by field paths.
_KNOWN = {*IMAGES, CAMERA_INFO, JOINT_STATE, ODOMETRY, STRING, TRANSFORMS}


def describe(
    recording: Recording, config: RigConfig, urdf_text: str | None, joints_too: bool = False
) -> tuple[RobotDescription, Survey]:
    """The description, and what it and a configuration determine.

    Numbers in other messages are read only if no wheel is known without them.

    Args:
        recording: the open recording.
        config: the configuration.
        urdf_text: text of the URDF to use in place of the one in the recording.
        joints_too: read these numbers also where anything else is unknown, as candidates for head joints.

    Raises:
        RecordingError: the recording is empty.
    """
    description = read_description(recording)
    wanted = needs_numbers(config, description)
    survey = None if wanted else survey_rig(config, description, urdf_text)
    if survey is None or (joints_too and survey.lacks):
        others = [topic.name for topic in description.topics if topic.type not in _KNOWN]
        description = replace(description, numbers=number_fields(recording, others, may_be_a_reading))
        survey = survey_rig(config, description, urdf_text)
    return description, survey
