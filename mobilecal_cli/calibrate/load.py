"""Input of the commands: recordings, or the extraction.npz of an earlier run."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from mobilecal_cli import se3
from mobilecal_cli.arguments import AnyPath, path_of, require
from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.extract import extract, refuse_equal_files, refuse_equal_recordings
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export.extraction import extraction_from_npz, snapshots_from_npz
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.files.reading import LARGEST_BYTES, read_text
from mobilecal_cli.likelihood.constants import camera_change, table
from mobilecal_cli.model.calibration import CalibratedRobot, Parameters
from mobilecal_cli.model.observations import Extraction, Snapshot
from mobilecal_cli.model.rig import SIDES
from mobilecal_cli.readers import looks_recorded
from mobilecal_cli.rig.config import RigConfig, checked_settings
from mobilecal_cli.rig.settings import refuse_others, settings_of, with_settings

#: The hint for a calibration and measurements that do not belong together; what to set follows.
OTHER_ROBOT = "give the calibration of this robot; if this is it, set"
_ARCHIVE = b"PK\x03\x04"  # the first bytes of a zip file


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """What recordings contain: everything the numbers need, and images for the report.

    Attributes:
        extraction: the measurements.
        snapshots: images of the stations; thumbnails alone from an extraction.npz.
        gates: limits of the configuration, by name.
    """

    extraction: Extraction
    snapshots: tuple[Snapshot, ...] = ()
    gates: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse anything else than measurements."""
        require("extraction", self.extraction, Extraction, "what from_poses() returns, or use extract()")

    def __repr__(self) -> str:
        return f"Data({self.extraction!r})"


def load(logs: Sequence[Path], config: RigConfig, progress: Progress = silent, jobs: int = 1) -> Data:
    """What recordings contain, or an extraction.npz.

    Raises:
        RecordingError: a recording or an extraction cannot be used.
        ConfigError: an extraction was given together with recordings, or with settings that were used to make it, or
            a recording twice.
    """
    archive = next(filter(is_archive, logs), None)
    if archive is None:
        for path in logs:
            with suppress(OSError):  # what cannot be read is refused where it is opened
                if (inside := path / "extraction.npz").is_file() and not looks_recorded(path):
                    raise RecordingError(f"{path}: a directory without a recording", f"give {inside}")
        return Data(*extract(logs, config, progress, jobs), config.gates)
    if len(logs) > 1 or config.path is not None:
        raise ConfigError(
            f"{archive}: an extraction contains its settings and cannot be combined with others",
            "give it without recordings and without --config, or give the recordings instead",
        )
    refuse_others(config.flags, str(archive))
    extraction = with_settings(read_extraction(archive), config)
    return Data(extraction, snapshots_from_npz(archive), config.gates)


def is_archive(path: Path) -> bool:
    """Whether a file is a zip file such as an .npz, also a truncated one."""
    with suppress(OSError):
        if path.is_file():
            with path.open("rb") as stream:
                return stream.read(len(_ARCHIVE)) == _ARCHIVE or zipfile.is_zipfile(stream)
    return False


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


def read_params(params: AnyPath) -> CalibratedRobot:
    """The calibration in a params.yaml.

    Raises:
        ConfigError: the file cannot be read, or is not a params.yaml.
    """
    path = path_of("params", params)
    hint = (
        "give a params.yaml that mobilecal wrote; evaluate takes it last: mobilecal evaluate LOG params.yaml"
    )
    text = read_text(path, LARGEST_BYTES, hint, "params.yaml")
    return parameters_from_yaml(text, str(path))


def differences(robot: CalibratedRobot, extraction: Extraction) -> tuple[str, ...]:
    """What shows that a calibration was not made from these measurements: recordings, names and nominal sizes."""
    rig, nominal = extraction.rig, extraction.rig.nominal.wheels
    wheel_joints = {side: rig.sources.wheels[side].joint for side in SIDES if rig.sources.wheels[side].joint}
    logs, other_logs = (", ".join(sorted({log.sha256[:8] for log in of.logs})) for of in (robot, extraction))
    pairs: list[tuple[str, object, object]] = [
        ("recordings (SHA-256)", logs, other_logs),
        ("head frame", robot.parent_frame, rig.chain.head_frame),
        ("camera frame", robot.child_frame, rig.cameras.of_reference.frame_id),
        ("wheel joints", dict(robot.wheel_joints), wheel_joints),
    ]
    if robot.nominal_wheels is not None and nominal is not None:
        mm, other_mm = (
            " ".join(f"{1e3 * m:.6g}" for m in of.vector) for of in (robot.nominal_wheels, nominal)
        )
        pairs.append(("nominal wheels in mm", mm, other_mm))
    return tuple(
        f"{what}: {own} in the calibration, {other} in the measurements"
        for what, own, other in pairs
        if own and other and own != other
    )


def parameters_of(robot: CalibratedRobot, extraction: Extraction, path: Path) -> Parameters:
    """The nine parameters of a calibration for the first camera of a recording's robot.

    Raises:
        ConfigError: the calibration is for other frames.
    """
    cameras = extraction.rig.cameras
    here = (extraction.rig.chain.head_frame, cameras.of_reference.frame_id)
    if (robot.parent_frame, robot.child_frame) != here:
        keys = [f"head.head_frame to {robot.parent_frame}"] if robot.parent_frame != here[0] else []
        if robot.child_frame != here[1]:
            named = {camera.frame_id: name for name, camera in zip(cameras.names, cameras.each, strict=True)}
            name = named.get(robot.child_frame)
            keys.append("the cameras of the calibration" if name is None else f"cameras.reference to {name}")
        raise ConfigError(
            f"{path} gives the pose of {robot.child_frame!r} on {robot.parent_frame!r}; in the recording the camera "
            f"frame is {here[1]!r} and the head frame is {here[0]!r}",
            f"{OTHER_ROBOT} {' and '.join(keys)} in rig.yaml",
        )
    rows = table(cameras, extraction.rig.chain)
    estimated = camera_change(cameras, rows, robot.constants).apply(cameras)
    return Parameters(robot.T_parent_child @ se3.inverse(estimated.T_c_reference), robot.wheels)
