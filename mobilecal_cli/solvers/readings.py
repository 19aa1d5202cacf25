"""What cameras, joints and wheels of a recording say at its stations, for the search for mistakes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import MotionSeen, encoder_steps_rad, head_pose, motion_seen
from mobilecal_cli.likelihood.measurements import (
    MotionPairs,
    legs_between,
    planar_pose,
    steps_between,
)
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.rig import Rig
from mobilecal_cli.model.signals import Track
from mobilecal_cli.solvers.linear import NominalPrior, nominal_of

FEWEST_STATIONS = 5  # of a recording, or of a part of one: with fewer legs, many mistakes fit
# Reprojection error over the focal length beyond which the images are wrong, not a joint or the wheels: of 120 robots
# with cameras as far off as their priors, the largest has 0.006.
_CONSISTENT_RAD = 0.0075
_TURNED_RAD = 0.5  # wheel rotation: with less, noise looks like a turn


@dataclass(frozen=True, eq=False)
class Readings:
    """What cameras, joints and wheels of N stations say.

    Attributes:
        rig: the robot.
        T_c_k: (N, 4, 4) board in the first camera.
        corners_k: (4, 3) outer corners of the board, m.
        joints: (N, J) readings, rad or m.
        time_ns, log: (N,) stamps, and index of the recording.
        wheels, joint_tracks: see `Extraction`.
        reprojection_px: at most stations, of the board where the images show it.
        measured: whether the board's poses were measured in place of corners.
        motions: (L, 3) x, y (m) and heading (rad) of a planar sensor, one for each recording; none where there is a
            board.
    """

    rig: Rig
    T_c_k: FloatArray
    corners_k: FloatArray
    joints: FloatArray
    time_ns: IntArray
    log: IntArray
    wheels: tuple[WheelTrack, ...]
    joint_tracks: tuple[tuple[Track, ...], ...]
    reprojection_px: float
    measured: bool
    motions: FloatArray

    def of(self, stations: IntArray | BoolArray | slice) -> Readings:
        """Some stations alone."""
        by_station = ("T_c_k", "joints", "time_ns", "log")
        return replace(self, **{name: getattr(self, name)[stations] for name in by_station})

    def with_motions(self, motions: FloatArray) -> Readings:
        """With other motions (L, 3) of a planar sensor, and the poses of a target that follow."""
        ends = legs_between(self.log)
        T_c_k = self.T_c_k.copy()
        T_c_k[ends[:, 1]] = se3.inverse(planar_pose(motions[self.log[ends[:, 1]]])) @ T_c_k[ends[:, 0]]
        return replace(self, T_c_k=T_c_k, motions=motions)

    def at_s(self, station: int) -> str:
        """Time of a station from the beginning of its recording."""
        begin = self.wheels[int(self.log[station])].time_ns[0]
        return f"{(int(self.time_ns[station]) - int(begin)) / 1e9:.1f}"

    @property
    def consistent(self) -> bool:
        """Whether the images of a station fit camera_info, the board and one another."""
        focal_px = self.rig.cameras.first.K[0, 0]
        return self.reprojection_px < _CONSISTENT_RAD * float(focal_px)

    @property
    def legs(self) -> int:
        """Number of legs."""
        return len(self.log) - len(np.unique(self.log))

    @property
    def nominal(self) -> NominalPrior:
        """Nominal values of the robot."""
        return nominal_of(self.rig)

    @cached_property
    def pairs(self) -> MotionPairs:
        """The legs, with the outer corners of the board."""
        points_c = se3.act(self.T_c_k, np.broadcast_to(self.corners_k, (len(self.T_c_k), 4, 3)))
        steps = steps_between(self.wheels, self.log, self.time_ns)
        return MotionPairs.of(head_pose(self.rig.chain, self.joints), self.T_c_k, points_c, self.log, steps)

    @cached_property
    def motion(self) -> MotionSeen:
        """What joints and wheels move."""
        pairs = self.pairs
        return motion_seen(pairs.T_v_h, pairs.steps.totals_rad, encoder_steps_rad(self.wheels))

    @property
    def roams(self) -> bool:
        """Whether the base drives and turns, on enough legs: that can tell mistakes apart."""
        if self.legs < FEWEST_STATIONS - 1:
            return False
        motion = self.motion
        return motion.drives and motion.turns and motion.turned_rad > _TURNED_RAD

    @property
    def distinguishes(self) -> bool:
        """Whether the head tilts, too: then the motion shows all nine parameters."""
        return self.roams and self.motion.tilts


def readings_of(extraction: Extraction) -> Readings:
    """The readings of an extraction with at least one leg."""
    observations, board = extraction.observations, extraction.board
    grid = board.grid().reshape(-1, 3) * extraction.square_m
    ends = [0, board.columns - 1, len(grid) - board.columns, len(grid) - 1]
    return Readings(
        extraction.rig,
        np.stack([o.T_c_k for o in observations]),
        grid[ends],
        np.stack([o.joints for o in observations]),
        np.array([o.time_ns for o in observations], dtype=np.int64),
        np.array([o.log for o in observations], dtype=np.int64),
        extraction.wheels,
        extraction.joint_tracks,
        float(np.median([o.reprojection_px for o in observations])),
        extraction.measured,
        np.array([each.motion for each in extraction.motions]).reshape(-1, 3),
    )
