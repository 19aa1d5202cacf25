"""Opening of recordings: the format is detected from the contents, never from the suffix."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path, PurePath

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.reading import LARGEST_BYTES, load_yaml, read_text
from mobilecal_cli.files.scratch import full_disk_told, scratch_directory
from mobilecal_cli.readers.containers import mcap, rosbag1, sqlite
from mobilecal_cli.readers.containers.recording import Recording, boundary
from mobilecal_cli.readers.containers.storage import LATEST_NS, LEAST_STEP_NS, Storage, expand
from mobilecal_cli.readers.messages import ZSTD_MAGIC

#: First bytes of a file → its reader.
CONTAINERS: dict[bytes, Callable[[Path], Storage]] = {
    mcap.MAGIC: mcap.McapStorage,
    rosbag1.MAGIC: rosbag1.BagStorage,
    sqlite.MAGIC: sqlite.SqliteStorage,
}
#: Suffixes of recorded files.
SUFFIXES = frozenset({".mcap", ".bag", ".db3", ".zstd", ".zst"})
KNOWN = (
    "mobilecal reads MCAP files, rosbag2 directories and .db3 files, and ROS 1 bags (format 2.0); calibrate, evaluate "
    "and suggest also an extraction.npz"
)


def open_recording(paths: Sequence[Path]) -> Recording:
    """Open files or directories as one recording.

    Args:
        paths: MCAP files, ROS 1 bags, .db3 files (each also as a zstd-compressed file), or rosbag2
            directories with or without metadata.yaml. Several paths are parts of one recording, in any order.

    Raises:
        RecordingError: no usable data: missing, empty, not a recording, or damaged.
    """
    if not paths:
        raise RecordingError("no recording given", "give one: mobilecal calibrate LOG")
    with ExitStack() as stack:
        recording = stack.enter_context(Recording(paths))
        for path in paths:
            with boundary(path):
                if not path.exists():
                    raise RecordingError(f"{path}: no such file or directory", "check the path")
                if path.is_dir() or path.name == METADATA:
                    _add_directory(recording, path if path.is_dir() else path.parent)
                else:
                    recording.parts.append(_opened(recording, path))
        if not recording.parts:
            raise RecordingError("; ".join(recording.damage), KNOWN)
        undo_steps(recording.parts)
        recording.complete()
        if recording.damage and not any(info.count for info in recording.topics):
            raise RecordingError(
                f"{recording.name}: nothing usable is left: {'; '.join(recording.damage)}",
                "copy the recording again, or record a new one",
            )
        stack.pop_all()  # the recording stays open
    return recording


def _opened(recording: Recording, path: Path) -> Storage:
    """A file, which is closed together with the recording."""
    magic = _magic(path)
    trouble = ""
    source = path
    if magic == ZSTD_MAGIC:
        folder = recording.enter_context(scratch_directory())
        source = folder / path.stem
        with path.open("rb") as packed, full_disk_told():
            trouble = expand(packed, source)
        magic = _magic(source, path)
    if magic not in CONTAINERS:
        raise RecordingError(f"{path}: not a recording", KNOWN)
    storage = CONTAINERS[magic](source)
    recording.callback(storage.close)
    if trouble:
        storage.note(
            f"the compressed file is truncated or damaged ({trouble}); the decompressed part is used"
        )
    return storage


def _add_directory(recording: Recording, folder: Path) -> None:
    listed = _listed(recording, folder) if (folder / METADATA).is_file() else []
    names = {_unpacked(path.name) for path in listed}
    entries = sorted(folder.iterdir())
    inside = [f"{path.name}/" for path in entries if path.is_dir() and looks_recorded(path)]
    # The player unpacks a compressed file next to it.
    others = [path for path in entries if _unpacked(path.name) not in names]
    files = [path for path in others if recognised(path)]
    for path in others:
        if path.suffix in SUFFIXES and path not in files and path.is_file():
            recording.note(f"{path}: not a recording, or empty; it is skipped")
    if listed:
        if files or inside:
            raise _several(folder, [", ".join(p.name for p in listed), *(p.name for p in files), *inside])
        for path in listed:
            try:
                with boundary(path):
                    recording.parts.append(_opened(recording, path))
            except RecordingError as error:  # the other parts may suffice
                recording.note(f"{error.message}; this part is skipped")
        return
    if not files and not inside:
        raise RecordingError(
            "; ".join((f"{folder}: no recording in this directory", *recording.damage)), KNOWN
        )
    storages = [_opened(recording, path) for path in files]
    groups = [", ".join(storages[i].path.name for i in group) for group in group_splits(storages)]
    if len(groups) > 1 or inside:
        raise _several(folder, [*groups, *inside])
    recording.parts += storages


def _several(folder: Path, recordings: Sequence[str]) -> RecordingError:
    """Why a directory is refused: it has several recordings, or one in a directory of its own."""
    count = f"{len(recordings)} recordings" if len(recordings) > 1 else "a directory with a recording"
    return RecordingError(
        f"{folder}: contains {count}: {'; '.join(recordings)}",
        "give the recording to use, or give all recordings of one robot to calibrate them together",
    )


def _listed(recording: Recording, folder: Path) -> list[Path]:
    """Files listed in metadata.yaml, whose message counts the recording receives; empty if it cannot be used."""
    try:
        information = load_yaml(read_text(folder / METADATA, LARGEST_BYTES))["rosbag2_bagfile_information"]
        names = dict.fromkeys(PurePath(name).name for name in information["relative_file_paths"])
        stated = {
            str(entry["topic_metadata"]["name"]): int(entry["message_count"])
            for entry in information.get("topics_with_message_count") or ()
        }
    except Exception as error:  # a damaged YAML file may raise anything
        recording.note(
            f"{folder / METADATA}: cannot be used ({type(error).__name__}: {error}); "
            "the files in the directory are read instead"
        )
        return []
    recording.stated.update(stated)
    return [folder / name for name in names]


def _magic(path: Path, name: Path | None = None) -> bytes:
    """Which known first bytes a file has, b"" for none.

    Raises:
        RecordingError: the file is missing or empty.
    """
    name = name or path
    if not path.is_file():
        what = "not a regular file" if path.exists() else "no such file"
        raise RecordingError(f"{name}: {what}", "check the path")
    with path.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise RecordingError(
            f"{name}: the file is empty (0 bytes)", "copy the recording again, or record a new one"
        )
    if head.startswith(b"#ROSBAG V") and not head.startswith(rosbag1.MAGIC):
        raise RecordingError(
            f"{name}: ROS 1 bag of format {head[9:12].decode(errors='replace')}, only 2.0 is supported",
            "convert it with rosbag fix or rosbag filter",
        )
    known = (*CONTAINERS, ZSTD_MAGIC)
    return next((magic for magic in known if head.startswith(magic)), b"")


def _unpacked(name: str) -> str:
    """Name of a recorded file without the suffix of its compression."""
    return name.removesuffix(".zstd").removesuffix(".zst")


def looks_recorded(path: Path) -> bool:
    """Whether a file or directory is a recording by its contents or its name: it may be empty or damaged."""
    if not path.is_dir():
        return path.suffix in SUFFIXES or recognised(path)
    with suppress(OSError):
        return any(p.is_file() and (p.suffix in SUFFIXES or p.name == METADATA) for p in path.iterdir())
    return False


def recognised(path: Path) -> bool:
    """Whether a file begins like a recording."""
    try:
        return _magic(path) != b""
    except (RecordingError, OSError):
        return False


def join_splits(paths: Sequence[Path]) -> list[list[Path]]:
    """Group the user's paths into recordings.

    See `group_splits` for the rule: times and topics decide, not names. A directory counts like a file.

    Returns:
        Groups of paths, in order of their first path; each in order of time.

    Raises:
        RecordingError: a path cannot be opened.
    """
    if len(paths) < 2:
        return [list(paths)] if paths else []
    recordings = []
    for path in paths:
        with open_recording([path]) as recording:
            recordings.append(recording)
    return [[paths[i] for i in group] for group in group_splits(recordings)]


#: A recorder that splits files continues at once; a longer pause means a new recording.
LARGEST_GAP_NS = 5 * 10**9


def group_splits(files: Sequence[Storage | Recording]) -> list[list[int]]:
    """Indices of the files, grouped into recordings.

    Two files belong together if the later one begins within 5 s after the end of the earlier one (or up to 1 s before
    it, because messages wait in the recorder's queue while it changes files) and they share a topic, as from a recorder
    that splits files; or if they overlap in time and share no topic, as from two recorders that run side by side. Empty
    files form their own group.

    Returns:
        Groups in order of their first file; each in order of time.
    """
    groups: list[list[int]] = []
    for index in sorted(range(len(files)), key=lambda i: (files[i].start_ns or 0, i)):
        home = next((g for g in reversed(groups) if _continues([files[i] for i in g], files[index])), None)
        if home is None:
            groups.append([index])
        else:
            home.append(index)
    return sorted(groups, key=min)


def _continues(group: Sequence[Storage | Recording], file: Storage | Recording) -> bool:
    ends = [member.end_ns for member in group if member.end_ns is not None]
    if file.start_ns is None or not ends:
        return False
    gap_ns = file.start_ns - max(ends)
    if any(file.topic_names & member.topic_names for member in group):
        return -LEAST_STEP_NS <= gap_ns < LARGEST_GAP_NS
    return gap_ns < 0


def undo_steps(files: Sequence[Storage]) -> None:
    """Let log times go on from file to file where the recorder's clock stepped back in one of them, or between two.

    Args:
        files: parts of one recording, in the order of writing. Other files may be among them, in any order.
    """
    for before, file in pairwise(files):
        if before.start_ns is None or before.end_ns is None or file.start_ns is None or file.end_ns is None:
            continue
        start_ns, end_ns = before.start_ns - before.shift_ns, before.end_ns - before.shift_ns
        if file.start_ns - end_ns >= LARGEST_GAP_NS or not before.topic_names & file.topic_names:
            continue
        shift_ns = before.shift_ns
        if file.start_ns < end_ns - LEAST_STEP_NS and file.end_ns > start_ns + LEAST_STEP_NS:
            shift_ns += end_ns - file.start_ns
            file.note_step(end_ns - file.start_ns)
        if shift_ns and file.end_ns + shift_ns < LATEST_NS:
            file.delay(shift_ns)


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
    try:
        if not path.exists():
            raise RecordingError(f"{path}: no such file or directory", "check the path")
        if not path.is_dir() and not path.is_file():  # reading a pipe would wait forever
            raise RecordingError(f"{path}: not a regular file", "give a recording: a file or a directory")
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            with file.open("rb") as stream:
                hashlib.file_digest(stream, lambda: digest)
    except OSError as error:
        raise RecordingError(
            f"{error.filename or path}: cannot be read: {error.strerror}", "check its permissions"
        ) from error
    return digest.hexdigest()
