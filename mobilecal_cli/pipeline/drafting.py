"""`mobilecal init`: a draft of rig.yaml from the robot description and topics of a recording."""

from __future__ import annotations

from pathlib import Path

from mobilecal_cli.discovery import draft_rig
from mobilecal_cli.export.single_file import write_file
from mobilecal_cli.readers import open_recording, read_prelude


def draft(log: Path) -> str:
    """Commented draft of rig.yaml for a recording.

    Raises:
        RecordingError: the recording cannot be read.
    """
    with open_recording([log]) as recording:
        return draft_rig(read_prelude(recording), log.name)


def write_draft(log: Path, output: Path, force: bool) -> None:
    """Write the draft to a file.

    Raises:
        RecordingError: the recording cannot be read.
        OutputError: the file already exists or cannot be written.
    """
    write_file(output, draft(log).encode(), force)
