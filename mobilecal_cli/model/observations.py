"""Measurements: the data between detection (slow) and solving (fast), without images."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray, ReadOnly, set_corner_defaults
from mobilecal_cli.model.rig import Board, Rig
from mobilecal_cli.model.signals import Rejection, Track


@dataclass(frozen=True, slots=True, eq=False)
class Corners(ReadOnly):
    """Corners of the board in one image, or averaged over the images of a rest.

    Attributes:
        pixels: (M, 2) corner positions, px, (0, 0) the center of the first pixel, in the board's numbering.
        sigma_px: standard deviation of one coordinate of a typical corner, px: from the scatter over the images of a
            rest (already divided by the square root of their number), or from the residuals of a smooth board.
        pictures: number of averaged images.
        seen: (M,) true for detected corners, all by default. The `pixels` of the others come from the fitted board
            and are no measurement.
        relative_cov: (M, 2, 2) covariance of each corner over the square of `sigma_px`, identity by default.
    """

    pixels: Annotated[FloatArray, "M", 2]
    sigma_px: float
    pictures: int
    seen: Annotated[BoolArray, "M"] = field(default_factory=lambda: np.ones(0, dtype=np.bool_))
    relative_cov: Annotated[FloatArray, "M", 2, 2] = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def __post_init__(self) -> None:
        set_corner_defaults(self, "relative_cov", 1.0)
        ReadOnly.__post_init__(self)

    @property
    def cov_px2(self) -> FloatArray:
        """Covariance of each corner, (M, 2, 2), px^2."""
        return self.sigma_px**2 * self.relative_cov


@dataclass(frozen=True, slots=True, eq=False)
class Observation(ReadOnly):
    """The board in the cameras at one station.

    Attributes:
        log: index of the recording; legs connect stations of one recording only.
        station: index of the station in its recording.
        time_ns: the station's time.
        at_rest: see `Station`.
        joints: (J,) see `Station`.
        joints_std: (J,) see `Station`.
        views: corners in each camera of the rig, same numbering; none of them `seen` in a camera without the board.
        points_c: (M, 3) triangulated corners in the first camera's frame, m; corners not detected by two cameras
            come from the fitted board.
        points_cov: (M, 3, 3) their covariances, m^2.
        T_c_k: (4, 4) board coordinates to first camera coordinates, minimizing the reprojection error.
        T_c_k_cov: (6, 6) covariance of T_c_k, tangent order of `se3` (rotation, then translation), left
            perturbation: T = exp(delta) T_c_k.
        square_m: square size from the triangulated points, m; as stated where one camera alone shows the board.
        reprojection_px: rms of the reprojection residual per coordinate, px.
    """

    log: int
    station: int
    time_ns: int
    at_rest: bool
    joints: Annotated[FloatArray, "J"]
    joints_std: Annotated[FloatArray, "J"]
    views: tuple[Corners, ...]
    points_c: Annotated[FloatArray, "M", 3]
    points_cov: Annotated[FloatArray, "M", 3, 3]
    T_c_k: Annotated[FloatArray, 4, 4]
    T_c_k_cov: Annotated[FloatArray, 6, 6]
    square_m: float
    reprojection_px: float

    @property
    def several(self) -> bool:
        """Whether several cameras show the board: the distances between them measure its squares."""
        return sum(bool(view.seen.any()) for view in self.views) > 1

    @property
    def shown(self) -> bool:
        """Whether any corner was detected; otherwise the pose was measured."""
        return any(bool(view.seen.any()) for view in self.views)


@dataclass(frozen=True, eq=False)
class WheelTrack:
    """Rotations of both wheels since the start of one recording.

    Each wheel keeps its own readings: interpolated ones would no longer show the step of its encoder.

    Attributes:
        right, left: unwrapped rotation, rad, positive when driving forward. A wheel turns at a constant rate between
            two readings, so the base moves on arcs.
    """

    right: Track
    left: Track

    @classmethod
    def at_same_times(cls, time_ns: IntArray, right_rad: FloatArray, left_rad: FloatArray) -> WheelTrack:
        """Both wheels read at the same times, (n,) each."""
        return cls(Track(time_ns, right_rad), Track(time_ns, left_rad))

    @cached_property
    def time_ns(self) -> IntArray:
        """(n,) stamps of both wheels within the time that both cover, strictly increasing."""
        right, left = self.right.time_ns, self.left.time_ns
        if not (len(right) and len(left)):
            return np.zeros(0, dtype=np.int64)
        times = right if np.array_equal(right, left) else np.union1d(right, left)
        shared = (times >= max(right[0], left[0])) & (times <= min(right[-1], left[-1]))
        return np.asarray(times[shared], dtype=np.int64)

    @cached_property
    def right_rad(self) -> FloatArray:
        """(n,) rotation of the right wheel at `time_ns`, interpolated."""
        return self.right.at(self.time_ns)

    @cached_property
    def left_rad(self) -> FloatArray:
        """(n,) rotation of the left wheel at `time_ns`, interpolated."""
        return self.left.at(self.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class SensorMotion(ReadOnly):
    """A leg of the base, and how a planar sensor on it moved meanwhile (scan matching, visual odometry).

    Attributes:
        right_rad, left_rad: rotation of the wheels over the leg, positive when driving forward.
        motion: (3,) x, y (m) and heading (rad) of the sensor at the end, in its own frame at the start.
        covariance: (3, 3) of the motion. Its scale is estimated.
    """

    right_rad: float
    left_rad: float
    motion: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]


@dataclass(frozen=True, slots=True)
class LogSource:
    """A recording.

    Attributes:
        path: as given by the user.
        sha256: hash of the file; of a directory, over its files sorted by name.
    """

    path: str
    sha256: str


#: Words that mean nothing where poses were measured, and what does.
_OF_ARGUMENTS = (
    (r",? or state ticks_per_revolution: 360 in rig\.yaml|( in head\.chain)? or in the URDF", ""),
    (r"the head chain in the URDF, and |, and board\.square_m in rig\.yaml", ""),
    (r"in head\.chain, in the URDF or in joints\.fields, or in the recording", "in chain, or in the poses"),
    (r"\bthe topics? and the |\bthe topic, the ", "the "),
    (r"the unit and the ticks_per_revolution of the wheel readings", "the unit of the rotations of the wheels"),
    (r"set the unit in joints\.fields in rig\.yaml", "give them in rad"),
    (r"board\.square_m, of the camera poses", "the measured poses"),
    (r"wheels\.(left|right)(\.sign)?\b", r"\1_rad"),
    (r"nominal\.wheels", "wheels_m"),
    (r"nominal\.head_eye", "T_h_c"),
    (r"(: bits)? in rig\.yaml", ""),
    (r"\btopics, ", ""),
    (r"with the whole board in the images", "with the whole target in view"),
    (r"\bthe images\b", "the poses"),
    (r"\b([Cc])amera(?=s?\b)", lambda found: f"{'S' if found[1] == 'C' else 's'}ensor"),
    (r"\b(the|neither the|nor the) board\b", r"\1 target"),
)  # fmt: skip
_NOTED = 3  # notes that a hint repeats


@dataclass(frozen=True, slots=True, eq=False)
class Extraction:
    """All measurements that the solver needs, without images.

    Attributes:
        rig: the robot.
        board: the board, with known numbers of corners.
        observations: sorted by log and time.
        wheels: one track per log: a recording, or a piece of it between steps of its clocks.
        rejections: rejected images and stations.
        notes: whole sentences about the input, for the report.
        logs: the files of the recordings.
        counts: "stations" found, "pictures" searched, ...
        joint_tracks: head joints over time, one tuple per log in the order of `HeadChain.joints`; empty if
            unknown, and then clock offset and backlash cannot be estimated.
        motions: of a planar sensor, one for each log, which is one leg; empty where there are none.
    """

    rig: Rig
    board: Board
    observations: tuple[Observation, ...]
    wheels: tuple[WheelTrack, ...]
    rejections: tuple[Rejection, ...]
    notes: tuple[str, ...]
    logs: tuple[LogSource, ...]
    counts: Mapping[str, int]
    joint_tracks: tuple[tuple[Track, ...], ...] = ()
    motions: tuple[SensorMotion, ...] = ()

    def __repr__(self) -> str:
        """One line."""
        files = ", ".join(log.path for log in self.logs[:3]) + (", ..." if len(self.logs) > 3 else "")
        logs = f"{len(self.wheels)} recording{'' if len(self.wheels) == 1 else 's'}"
        return f"Extraction({len(self.observations)} stations, {logs}: {files or 'no files'})"

    @property
    def log_names(self) -> tuple[str, ...]:
        """A name for each log: its file, or its number where files and logs do not correspond."""
        if len(self.logs) == len(self.wheels):
            return tuple(log.path for log in self.logs)
        return tuple(f"recording {number}" for number in range(1, len(self.wheels) + 1))

    def station_name(self, log: int, station: int) -> str:
        """A station in words: its index, behind the number of its recording, from 1, if there are several."""
        return f"{log + 1}:{station}" if len(self.wheels) > 1 else str(station)

    @property
    def legs(self) -> int:
        """Number of legs: each connects two stations of one recording."""
        return len(self.observations) - len({o.log for o in self.observations})

    @property
    def measured(self) -> bool:
        """Whether poses were measured in place of corners."""
        return bool(self.observations) and not any(o.shown for o in self.observations)

    @property
    def square_m(self) -> float:
        """Size of the squares, m: as stated, otherwise the median that several cameras measure."""
        stated = self.board.square_m
        return float(np.median([o.square_m for o in self.observations])) if stated is None else stated

    @property
    def board_distance_m(self) -> float:
        """Median distance from the first camera to the corners, m."""
        return float(np.median([np.linalg.norm(o.points_c, axis=-1).mean() for o in self.observations]))

    @property
    def first_notes(self) -> tuple[str, ...]:
        """Notes that the hint of an error repeats, each without its last dot."""
        return tuple(note.removesuffix(".") for note in self.notes[:_NOTED])

    def worded(self, text: str) -> str:
        """A text for the user, about arguments of Python and a sensor where there are neither rig.yaml nor images."""
        for word, instead in _OF_ARGUMENTS if self.measured else ():
            text = re.sub(word, instead, text)
        return text.replace("T_h_c", "T_v_c") if self.motions else text

    def of_log(self, log: int) -> Extraction:
        """The measurements of one log."""
        return replace(
            self,
            observations=tuple(replace(o, log=0) for o in self.observations if o.log == log),
            wheels=(self.wheels[log],),
            joint_tracks=self.joint_tracks[log : log + 1],
            motions=self.motions[log : log + 1],
        )


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The images of a station for the report.

    Attributes:
        log, station: of an observation, or of a rejected station.
        jpegs: name of each camera with an image → encoded gray image at full size.
        thumbnail: a small encoded gray image, of the camera that missed the board if one did; empty for none.
    """

    log: int
    station: int
    jpegs: Mapping[str, bytes]
    thumbnail: bytes = b""
