"""extraction.npz: all measurements needed to solve, and thumbnails of the stations; without pickle."""

from __future__ import annotations

import base64
import io
import itertools
import json
import math
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, ValidationError, field_serializer

from mobilecal_cli import __version__
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.reading import problems_of
from mobilecal_cli.model.arrays import dtypes
from mobilecal_cli.model.observations import Corners, Extraction, LogSource, Observation, Snapshot, WheelTrack
from mobilecal_cli.model.rig import Board, Rig
from mobilecal_cli.model.signals import Rejection, Track

SCHEMA_VERSION = 11
#: Most stations with a small image.
THUMBNAILS = 60
_LARGEST_THUMBNAIL = 10_000  # bytes
#: An hour of 100 Hz joints and wheels and a thousand stations of 100 corners are a quarter of this.
LARGEST_BYTES = 2**29
_LARGEST = 1e12
_FORMAT = "mobilecal extraction"
_OBSERVATION_ARRAYS, _CORNER_ARRAYS = dtypes(Observation), dtypes(Corners)
#: Last part of an array's name → its element type.
_DTYPES: dict[str, type | np.dtype[Any]] = {
    **_OBSERVATION_ARRAYS,
    **_CORNER_ARRAYS,
    "header": np.uint8,
    **dict.fromkeys(("rad", "right_rad", "left_rad", "value"), np.float64),
}
#: Fields of an extraction that its header has as they are.
_STATED = ("rig", "board", "rejections", "notes", "logs", "counts")
_HINT = "give an extraction.npz from this version of mobilecal, or calibrate from the recording"


class _Header(BaseModel):
    """What the file holds beside arrays, and how many of these."""

    model_config = ConfigDict(extra="forbid")

    format: str = _FORMAT
    schema_version: int = SCHEMA_VERSION
    made_by: str = __version__
    rig: Rig
    board: Board
    rejections: tuple[Rejection, ...]
    notes: tuple[str, ...]
    logs: tuple[LogSource, ...]
    counts: dict[str, int]
    observations: int
    wheels: int
    joint_tracks: tuple[int, ...]

    @field_serializer("rig", mode="wrap")
    def _finite(self, rig: Rig, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """JSON has no infinite numbers, which the sigmas of free constants are."""
        plain: dict[str, Any] = serialize(rig)
        sigmas = plain["prior_sigmas"].items()
        plain["prior_sigmas"] = {name: str(sigma) if math.isinf(sigma) else sigma for name, sigma in sigmas}
        return plain


def extraction_to_npz(extraction: Extraction, snapshots: Sequence[Snapshot] = ()) -> bytes:
    """The extraction and the thumbnails of its stations as a compressed .npz: the same bytes for the same values.

    Arrays are stacked over the N observations, so that numpy alone can read them: ``observations.points_c`` is
    (N, M, 3). All else is JSON in the uint8 array ``header``.

    Raises:
        ValueError: the observations have different numbers of corners or joints.
    """
    observations = extraction.observations
    header = _Header(
        **{name: getattr(extraction, name) for name in _STATED},
        observations=len(observations),
        wheels=len(extraction.wheels),
        joint_tracks=tuple(len(tracks) for tracks in extraction.joint_tracks),
    )
    thumbnails = [
        (s.log, s.station, base64.b64encode(s.thumbnail).decode("ascii")) for s in snapshots if s.thumbnail
    ]
    # Not as JSON by pydantic, which has none for names that are not UTF-8.
    text = json.dumps(
        header.model_dump() | {"thumbnails": thumbnails}, allow_nan=False, separators=(",", ":")
    )
    arrays: dict[str, NDArray[Any]] = {"header": np.frombuffer(text.encode("ascii"), dtype=np.uint8)}
    if observations:
        for name, dtype in _OBSERVATION_ARRAYS.items():
            arrays[f"observations.{name}"] = _stacked(observations, name, dtype)
        for k, camera in enumerate(extraction.rig.cameras.names):
            for name, dtype in _CORNER_ARRAYS.items():
                views = [o.views[k] for o in observations]
                arrays[f"observations.{camera}.{name}"] = _stacked(views, name, dtype)
    for i, track in enumerate(extraction.wheels):
        for side, wheel in (("right", track.right), ("left", track.left)):
            arrays[f"wheels.{i}.{side}.time_ns"] = wheel.time_ns
            arrays[f"wheels.{i}.{side}.rad"] = wheel.value
    for i, tracks in enumerate(extraction.joint_tracks):
        for j, joint in enumerate(tracks):
            arrays[f"joints.{i}.{j}.time_ns"] = joint.time_ns
            arrays[f"joints.{i}.{j}.value"] = joint.value
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def _stacked(values: Sequence[object], name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
    return np.stack([np.asarray(getattr(value, name), dtype) for value in values])


def snapshots_from_npz(path: Path) -> tuple[Snapshot, ...]:
    """The thumbnails beside a valid extraction; those that cannot be read are left out."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            listed = json.loads(arrays["header"].tobytes()).get("thumbnails", ())
        read = (Snapshot(int(log), int(station), {}, base64.b64decode(jpeg)) for log, station, jpeg in listed)
        return tuple(itertools.islice((s for s in read if len(s.thumbnail) < _LARGEST_THUMBNAIL), THUMBNAILS))
    except (ValueError, TypeError):
        return ()


def extraction_from_npz(source: bytes | Path) -> Extraction:
    """The extraction in an .npz from `extraction_to_npz`.

    Args:
        source: the file, or its bytes.

    Raises:
        RecordingError: the file cannot be read, is damaged, is not an extraction, or has another schema version.
    """
    name = "the extraction" if isinstance(source, bytes) else str(source)
    try:
        data = source if isinstance(source, bytes) else source.read_bytes()
    except OSError as error:
        raise RecordingError(f"{name}: cannot be read: {error.strerror}", "check the path") from error
    if not data.startswith(b"PK"):
        raise RecordingError(f"{name}: not an extraction ({len(data)} bytes, no .npz)", _HINT)
    try:
        arrays = _arrays(data)
        header = json.loads(arrays["header"].tobytes()) if arrays else None
    except Exception as error:  # a damaged zip or array may raise any exception
        raise RecordingError(f"{name}: damaged: {_said(error)}", _HINT) from error
    if not isinstance(header, dict) or header.get("format") != _FORMAT:
        raise RecordingError(
            f"{name}: a zip archive, but not an extraction",
            f"unpack it if it contains a recording, or {_HINT}",
        )
    version = header.get("schema_version")
    if version != SCHEMA_VERSION:
        raise RecordingError(
            f"{name}: schema version {version!r}; this version of mobilecal reads {SCHEMA_VERSION}", _HINT
        )
    try:
        return _extraction(header, arrays)
    except Exception as error:
        raise RecordingError(f"{name}: damaged: {_said(error)}", _HINT) from error


def _said(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return problems_of(error)
    return " ".join(str(error).split())[:200] or type(error).__name__


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """Name → array; none of an archive without the header of an extraction."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if "header.npy" not in archive.namelist():
            return {}
        stated = sum(member.file_size for member in archive.infolist())
        if stated > LARGEST_BYTES:
            raise ValueError(f"{len(data)} bytes unpack to {stated} bytes (limit {LARGEST_BYTES})")
        members = {name: name.removesuffix(".npy") for name in archive.namelist()}
        return {name: _array(name, archive.read(member)) for member, name in members.items()}


def _array(name: str, data: bytes) -> NDArray[Any]:
    """One array; its header is checked against its length before memory is allocated."""
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError(f"{name}: unknown array version")
    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    if math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise ValueError(f"{name}: {len(data)} bytes do not match shape {shape} of {dtype}")
    stream.seek(0)
    expected = np.dtype(_DTYPES.get(name.rpartition(".")[2], dtype))
    if not np.can_cast(dtype, expected, "safe"):
        raise ValueError(f"{name}: elements are {dtype}, expected {expected}")
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False).astype(expected)
    # No valid value in meters, radians or pixels is so large, and its square would overflow.
    if array.dtype.kind == "f" and not np.all(np.abs(array) < _LARGEST):
        raise ValueError(f"{name}: values that are not finite, or above {_LARGEST:g}")
    return array


def _extraction(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Extraction:
    stated = _Header.model_validate({name: header[name] for name in _Header.model_fields})
    names = stated.rig.cameras.names
    observations = tuple(_observation(arrays, names, i) for i in range(stated.observations))
    order = [(o.log, o.time_ns) for o in observations]
    if order != sorted(order) or not {o.log for o in observations} <= set(range(stated.wheels)):
        raise ValueError("stations that are not in the order of their recordings and times")
    return Extraction(
        **{name: getattr(stated, name) for name in _STATED},
        observations=observations,
        wheels=tuple(_wheels(arrays, f"wheels.{i}") for i in range(stated.wheels)),
        joint_tracks=tuple(
            tuple(
                Track(arrays[f"joints.{i}.{j}.time_ns"], arrays[f"joints.{i}.{j}.value"])
                for j in range(count)
            )
            for i, count in enumerate(stated.joint_tracks)
        ),
    )


def _wheels(arrays: dict[str, NDArray[Any]], name: str) -> WheelTrack:
    sides = (f"{name}.{side}" for side in ("right", "left"))
    wheels = WheelTrack(*(Track(arrays[f"{side}.time_ns"], arrays[f"{side}.rad"]) for side in sides))
    if not len(wheels.time_ns):
        raise ValueError(f"{name}: no readings of both wheels")
    return wheels


def _observation(arrays: dict[str, NDArray[Any]], names: Sequence[str], index: int) -> Observation:
    def values(prefix: str, fields: Iterable[str]) -> dict[str, Any]:
        each = {name: arrays[f"{prefix}.{name}"][index] for name in fields}
        return {name: value if value.ndim else value.item() for name, value in each.items()}

    views = tuple(Corners(**values(f"observations.{name}", _CORNER_ARRAYS)) for name in names)
    return Observation(**values("observations", _OBSERVATION_ARRAYS), views=views)
