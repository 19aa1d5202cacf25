"""Recordings into an extraction: everything slow, and the only part that sees images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli.config import RigConfig, read_urdf
from mobilecal_cli.discovery import settle_rig
from mobilecal_cli.errors import ConfigError, ObservationError
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model import (
    Board,
    Extraction,
    HeadChain,
    JointLink,
    LogSource,
    Markers,
    Observation,
    Rejection,
    Rig,
    Snapshot,
    WheelTrack,
)
from mobilecal_cli.pipeline.looking import Crew, look
from mobilecal_cli.pipeline.planning import WORTH_BYTES, plan_log
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.pipeline.seeing import Looks, Scene, board_size
from mobilecal_cli.readers import Recording, join_parts, open_recording, read_prelude, sha256_of
from mobilecal_cli.stations import Plan
from mobilecal_cli.uncertainty import FEWEST_STATIONS
from mobilecal_cli.vision import Detection, Measured, settle_numbering, settle_square


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One log, read, looked at and measured."""

    rig: Rig
    board: Board
    plan: Plan
    looks: Sequence[Looks]
    measured: Sequence[Measured | Rejection]
    snapshots: Sequence[Snapshot]
    notes: tuple[str, ...]


def sliding_joints(chain: HeadChain) -> frozenset[str]:
    """The joints of a head that slide: their readings are m."""
    return frozenset(
        link.joint for link in chain.links if isinstance(link, JointLink) and link.kind == "prismatic"
    )


def _plan(recording: Recording, rig: Rig, everything: bool) -> tuple[Plan, tuple[str, ...]]:
    return plan_log(recording, rig, sliding_joints(rig.chain), everything)


def _see(
    log: int,
    recording: Recording,
    crew: Crew,
    config: RigConfig,
    flags: frozenset[str],
    board: Board | None,
    progress: Progress,
) -> Seen:
    progress("reading", 0, None)
    settled = settle_rig(config, read_prelude(recording), read_urdf(config), flags)
    rig = settled.rig
    everything = config.stations == "all"
    if everything and recording.bytes_of(rig.sources.image.values()) >= WORTH_BYTES:
        crew.call()
    plan, notes = _plan(recording, rig, everything)
    if board is None:
        progress("finding the board's size", 0, None)
        size = board_size(recording, rig.sources, plan.stations)
        if size is None:
            raise ObservationError(
                f"no checkerboard was found in images of {len(plan.stations)} stations",
                "keep the whole board in both images, in good light, with squares of 7 pixels or more; or "
                "state its inner corners with --board, such as --board 9x6",
            )
        board = Board(*size, config.board.square_m)
    scene = Scene(rig.sources, rig.cameras, board)
    looks, snapshots = look(crew, scene, plan.stations, not everything, progress)
    found = any(isinstance(d, Detection) for seen in looks for d in seen.found["left"].values())
    if not found and config.board.columns is not None and board.markers is None:
        _refuse_wrong_size(recording, rig, plan, board)
    progress("measuring", 0, None)
    measured = crew.measure_at(log, scene, plan.stations, looks)
    return Seen(rig, board, plan, looks, measured, snapshots, (*settled.notes, *notes, *recording.damage))


def _refuse_wrong_size(recording: Recording, rig: Rig, plan: Plan, board: Board) -> None:
    """Look whether there is another board where the stated one is nowhere.

    Raises:
        ObservationError: naming the size that was seen.
    """
    size = board_size(recording, rig.sources, plan.stations)
    if size is not None and set(size) != {board.columns, board.rows}:
        raise ObservationError(
            f"the configuration says the board has {board.columns} x {board.rows} inner corners, the images "
            f"show one of {size[0]} x {size[1]}",
            f"state the board that was used: --board {size[0]}x{size[1]}, or board.columns and board.rows",
        )


def board_of(config: RigConfig) -> Board | None:
    """The board as configured, None where its size is to be found in the images."""
    given = config.board
    if not (given.columns and given.rows):
        return None
    markers = None
    if given.kind == "charuco":
        markers = Markers(
            "charuco", given.dictionary or "", given.marker_share or 0.0, given.first_id, given.border_bits
        )
    elif given.kind == "aprilgrid":
        family = given.dictionary or "DICT_APRILTAG_36h11"
        markers = Markers("aprilgrid", family, given.gap_share or 0.0, given.first_id, given.border_bits)
    return Board(given.columns, given.rows, given.square_m, markers)


def extract(
    logs: Sequence[Path],
    config: RigConfig,
    flags: frozenset[str] = frozenset(),
    progress: Progress = silent,
    jobs: int = 1,
) -> tuple[Extraction, tuple[Snapshot, ...]]:
    """Read recordings of one robot and find the board in their images.

    Files that follow one another in time are one recording in parts; the others are logs of their own, and
    no leg joins stations of two logs.

    Args:
        logs: recordings.
        config: see `config.load_rig`.
        flags: dotted keys that came from flags.
        progress: told how far it is.
        jobs: processes that may look at a long log's images and draw; more than one needs a main module that can be
            imported without doing anything, as for `multiprocessing`.

    Raises:
        MobilecalError: see `errors`.
    """
    board = board_of(config)
    seen: list[Seen] = []
    sources: list[LogSource] = []
    for parts in join_parts(logs):
        with open_recording(parts) as recording, Crew(recording, jobs) as crew:
            one = _see(len(seen), recording, crew, config, flags, board, progress)
        board = one.board
        if seen and one.rig.chain.joints != seen[0].rig.chain.joints:
            raise ConfigError(
                f"{parts[0]}: its head's joints are {', '.join(one.rig.chain.joints)}, those of {logs[0]} are "
                f"{', '.join(seen[0].rig.chain.joints)}",
                "give recordings of one robot",
            )
        seen.append(one)
        sources += [LogSource(str(path), sha256_of(path)) for path in parts]
    return _assembled(seen, sources)


def _assembled(seen: Sequence[Seen], sources: Sequence[LogSource]) -> tuple[Extraction, tuple[Snapshot, ...]]:
    board, rig = seen[0].board, seen[0].rig
    square_m = board.square_m
    if square_m is None:
        # One board, one square: its size is what the stereo baseline gives over all stations.
        sides = [m.square_m for one in seen for m in one.measured if isinstance(m, Measured)]
        square_m = float(np.median(sides)) if len(sides) >= FEWEST_STATIONS else None
    observations: list[Observation] = []
    rejections: list[Rejection] = []
    for log, one in enumerate(seen):
        settled = [settle_square(m, square_m) if isinstance(m, Measured) else m for m in one.measured]
        observations += [item for item in settled if isinstance(item, Observation)]
        lost = (rejection for looks in one.looks for rejection in looks.rejections)
        missed = (item for item in settled if isinstance(item, Rejection))
        rejections += [replace(r, log=log) for r in (*one.plan.rejections, *lost, *missed)]
    if observations:
        R_v_h = head_pose(rig.chain, np.stack([o.joints for o in observations]))[:, :3, :3]
        numbered, unsettled = settle_numbering(observations, R_v_h, board)
        observations, rejections = list(numbered), [*rejections, *unsettled]
    wheels: tuple[WheelTrack, ...] = tuple(one.plan.wheels for one in seen)
    counts: dict[str, Any] = {
        "stations": sum(len(one.plan.stations) for one in seen),
        "stations_at_rest": sum(s.at_rest for one in seen for s in one.plan.stations),
        "pictures": sum(len(found) for one in seen for looks in one.looks for found in looks.found.values()),
        "observations": len(observations),
    }
    extraction = Extraction(
        rig=rig,
        board=board,
        observations=tuple(observations),
        wheels=wheels,
        rejections=tuple(rejections),
        notes=tuple(dict.fromkeys(note for one in seen for note in one.notes)),
        logs=tuple(sources),
        counts=counts,
        joint_tracks=tuple(one.plan.joints for one in seen),
    )
    snapshots = tuple(replace(s, log=log) for log, one in enumerate(seen) for s in one.snapshots)
    return extraction, snapshots
