"""SHA-256 of a recording, for the provenance of results."""

from __future__ import annotations

import hashlib
from pathlib import Path

from mobilecal_cli.errors import RecordingError

#: File of a rosbag2 directory that lists its other files.
METADATA = "metadata.yaml"


def sha256_of(path: Path) -> str:
    """SHA-256 of a file; of a directory: of the bytes of its files, concatenated in order of name.

    The metadata.yaml of a rosbag2 stands for its directory.

    Raises:
        RecordingError: a file does not exist, is a device or a pipe, or cannot be read.
    """
    digest = hashlib.sha256()
    if path.name == METADATA:
        path = path.parent
    if not path.exists():
        raise RecordingError(f"{path}: no such file or directory", "check the path")
    if not path.is_dir() and not path.is_file():  # reading a pipe would wait forever
        raise RecordingError(f"{path}: not a regular file", "give a recording: a file or a directory")
    try:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            with file.open("rb") as stream:
                while piece := stream.read(2**20):
                    digest.update(piece)
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read: {error.strerror}", "check its permissions"
        ) from error
    return digest.hexdigest()
