"""SHA-256 of a recording, for the provenance of results."""

from __future__ import annotations

import hashlib
from pathlib import Path

from mobilecal_cli.errors import RecordingError


def sha256_of(path: Path) -> str:
    """SHA-256 of a file; of a directory: of the bytes of its files, concatenated in order of name.

    Raises:
        RecordingError: a file cannot be read.
    """
    digest = hashlib.sha256()
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
