"""What was seen: the values between seeing (slow) and solving (fast). No pictures in here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.model.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    freeze,
    freeze_corners,
    freeze_covariances,
)
from mobilecal_cli.model.rig import Board, Rig
from mobilecal_cli.model.signals import Rejection, Track


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The board in one picture, or averaged over the pictures of a rest.

    Attributes:
        pixels: (M, 2) corner centres, px, (0, 0) the centre of the first pixel, in the board's numbering.
        sigma_px: noise of one coordinate of a usual corner, px: measured scatter over the rest where there are
            several pictures (already divided by the square root of their number), otherwise what the
            corners' scatter about a smooth board shows.
        pictures: how many pictures were averaged.
        seen: (M,) the corners that were seen, all of them where nothing is said. The others' `pixels` are where the
            fitted board has them, and no measurement.
        relative_cov: (M, 2, 2) each corner's covariance over the square of `sigma_px`; the unit where nothing is said.
    """

    pixels: FloatArray
    sigma_px: float
    pictures: int
    seen: BoolArray = field(default_factory=lambda: np.ones(0, dtype=np.bool_))
    relative_cov: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def __post_init__(self) -> None:
        freeze_corners(self, self.seen)
        freeze_covariances(self, "relative_cov", self.relative_cov, 1.0)

    @property
    def cov_px2(self) -> FloatArray:
        """(M, 2, 2) covariance of each corner, px^2."""
        return self.sigma_px**2 * self.relative_cov


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """The board seen by both cameras at one station.

    Attributes:
        log: index of the recording; legs join stations of one recording only.
        station: index of the station in its log.
        time_ns: the station's time.
        at_rest: see `Station`.
        joints: (J,) see `Station`.
        joints_std: (J,) see `Station`.
        left, right: corners in each camera, same numbering.
        points_c: (M, 3) triangulated corners in the left camera's frame, m; those that a camera did not see lie
            where the fitted board has them.
        points_cov: (M, 3, 3) their covariances, m^2.
        T_c_k: (4, 4) board coordinates to left camera coordinates, minimising stereo reprojection.
        T_c_k_cov: (6, 6) covariance of T_c_k, tangent order of `se3` (rotation, then translation), left
            perturbation: T = exp(delta) T_c_k.
        square_m: side of a square that the triangulated points show, m.
        reprojection_px: rms of the stereo reprojection residual per coordinate, px.
    """

    log: int
    station: int
    time_ns: int
    at_rest: bool
    joints: FloatArray
    joints_std: FloatArray
    left: Corners
    right: Corners
    points_c: FloatArray
    points_cov: FloatArray
    T_c_k: FloatArray
    T_c_k_cov: FloatArray
    square_m: float
    reprojection_px: float

    def __post_init__(self) -> None:
        freeze(
            self,
            joints=("J",),
            joints_std=("J",),
            points_c=("M", 3),
            points_cov=("M", 3, 3),
            T_c_k=(4, 4),
            T_c_k_cov=(6, 6),
        )


@dataclass(frozen=True, slots=True, eq=False)
class WheelTrack:
    """Both wheels of one log on common times, rotations since the log's start.

    Attributes:
        time_ns: (n,) strictly increasing.
        right_rad, left_rad: (n,) unwrapped rotation, positive when driving forward. Between two samples
            both wheels turn at constant rates, so the base moves on an arc.
    """

    time_ns: IntArray
    right_rad: FloatArray
    left_rad: FloatArray

    def __post_init__(self) -> None:
        n = freeze(self, np.int64, time_ns=("n",))["n"]
        freeze(self, right_rad=(n,), left_rad=(n,))


@dataclass(frozen=True, slots=True)
class LogSource:
    """A recording that was read.

    Attributes:
        path: as the user gave it.
        sha256: of the file's bytes; of a directory, over its files in order of name.
    """

    path: str
    sha256: str


@dataclass(frozen=True, slots=True, eq=False)
class Extraction:
    """Everything that the numbers need, and no image.

    Attributes:
        rig: the robot.
        board: the checkerboard, its size known by now.
        observations: in order of log and time.
        wheels: one track a log.
        rejections: what was left out.
        notes: whole sentences about the reading, for the report.
        logs: the recordings.
        counts: what was looked at: "stations", "pictures", ...
        joint_tracks: the head's joints over time, one tuple a log in the order of `HeadChain.joints`; empty where
            they are not known, and then neither a clock's offset nor backlash can be seen.
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


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The pictures of a station, kept small for the report's overlays.

    Attributes:
        log, station: which observation.
        left_jpeg, right_jpeg: encoded gray pictures at full size.
    """

    log: int
    station: int
    left_jpeg: bytes
    right_jpeg: bytes
