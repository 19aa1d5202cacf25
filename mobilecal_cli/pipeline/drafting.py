"""`mobilecal init`: a draft of rig.yaml from a recording, a few of its images, and a URDF."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from mobilecal_cli.config import RigConfig, read_urdf
from mobilecal_cli.discovery import draft_rig, may_be_a_reading, survey_rig
from mobilecal_cli.export.outputs import check_file, write_file
from mobilecal_cli.model import CAMERA_INFO, IMAGES, JOINT_STATE, STRING, TRANSFORMS, Draft
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.pipeline.sampling import sample_board
from mobilecal_cli.readers import number_fields, open_recording, read_description

#: Types that are read by their meaning, not by field paths.
_KNOWN = {*IMAGES, CAMERA_INFO, JOINT_STATE, STRING, TRANSFORMS}


def draft(
    logs: Sequence[Path], urdf: Path | None = None, beside: Path | None = None, progress: Progress = silent
) -> Draft:
    """Commented draft of rig.yaml for a recording.

    Args:
        logs: parts of one recording.
        urdf: URDF file to use in place of the one in the recording.
        beside: directory of the rig.yaml, which the path of the URDF is relative to; the working directory by default.
        progress: receives the progress.

    Raises:
        RecordingError: the recording cannot be read.
        ConfigError: the URDF cannot be read.
    """
    config = RigConfig.model_validate({"head": {"urdf": urdf}} if urdf is not None else {})
    text = read_urdf(config)
    with open_recording(logs) as recording:
        progress("topics", 0, None)
        description = read_description(recording)
        survey = survey_rig(config, description, text)
        others = [topic.name for topic in description.topics if topic.type not in _KNOWN]
        numbers = () if not survey.lacks else number_fields(recording, others, may_be_a_reading)
        board = None
        if survey.images is not None:
            progress("images", 0, None)
            board, _ = sample_board(recording, survey.images, "separate", survey.cameras, None)
        made = draft_rig(
            description,
            logs[0].name,
            survey=survey,
            urdf_text=text,
            urdf_path=None if urdf is None else os.path.relpath(urdf, beside or Path()),
            board=board,
            numbers=numbers,
        )
        return Draft(made.text, made.filled, made.todo, (*made.notes, *recording.damage))


def write_draft(
    logs: Sequence[Path],
    output: Path,
    force: bool,
    urdf: Path | None = None,
    progress: Progress = silent,
) -> Draft:
    """Write the draft to a file.

    Raises:
        RecordingError, ConfigError: see `draft`.
        OutputError: the file already exists or cannot be written.
    """
    check_file(output, force, [*logs, urdf])
    made = draft(logs, urdf, output.parent, progress)
    write_file(output, made.text.encode(), force)
    return made
