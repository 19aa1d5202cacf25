"""Input of the commands: recordings, or the extraction.npz of an earlier run."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mobilecal_cli.config import RigConfig, checked_settings
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export import extraction_from_npz
from mobilecal_cli.model import Extraction, Snapshot
from mobilecal_cli.pipeline.extracting import extract
from mobilecal_cli.pipeline.overrides import refuse_others, with_settings
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.pipeline.repeated import refuse_equal_files, refuse_equal_recordings
from mobilecal_cli.pipeline.settings import settings_of


def _is_extraction(path: Path) -> bool:
    return path.is_file() and zipfile.is_zipfile(path)


def load(
    logs: Sequence[Path],
    config: RigConfig,
    config_path: Path | None,
    flags: Mapping[str, Any],
    progress: Progress,
    jobs: int = 1,
) -> tuple[Extraction, tuple[Snapshot, ...]]:
    """The extraction of recordings, or the one in an extraction.npz, with its snapshots.

    Args:
        logs: recordings, or one extraction.npz.
        config: the combination of `config_path` and `flags`.
        config_path: rig.yaml.
        flags: dotted key → value, overriding the file.
        progress: called with the progress.
        jobs: see `extract`.

    Raises:
        RecordingError: a recording or an extraction cannot be used.
        ConfigError: an extraction was given together with recordings, or with settings that were used to make it, or
            a recording twice.
    """
    given = frozenset(key for key, value in flags.items() if value is not None)
    if not any(_is_extraction(path) for path in logs):
        return extract(logs, config, given, progress, jobs)
    if len(logs) > 1 or config_path is not None:
        raise ConfigError(
            f"{logs[0]}: an extraction contains its settings and cannot be combined with others",
            "give it without recordings and without --config, or give the recordings instead",
        )
    refuse_others(given, str(logs[0]))
    return with_settings(read_extraction(logs[0]), config, given), ()


def read_extraction(path: Path) -> Extraction:
    """The extraction in an extraction.npz.

    Raises:
        RecordingError: it cannot be read, its parts do not match, or a setting is out of the range of rig.yaml.
        ConfigError: it contains a recording twice, as those of earlier versions may.
    """
    extraction = extraction_from_npz(path)
    tracks, logs, joints = len(extraction.wheels), len(extraction.logs), len(extraction.joint_tracks)
    if not logs or joints not in (0, tracks) or any(not 0 <= o.log < tracks for o in extraction.observations):
        raise RecordingError(
            f"{path}: damaged: {logs} recorded files, {tracks} wheel tracks, {joints} joint tracks, or observations "
            "without a recording",
            "calibrate again from the recordings",
        )
    try:
        checked_settings(settings_of(extraction), f"{path}: damaged: ")
    except (ConfigError, ArithmeticError, KeyError, ValueError) as error:
        reason = error.message if isinstance(error, ConfigError) else f"{path}: damaged: settings: {error}"
        raise RecordingError(reason, "calibrate again from the recordings") from error
    refuse_equal_files(extraction.logs)
    refuse_equal_recordings(extraction, extraction.log_names)
    return extraction
