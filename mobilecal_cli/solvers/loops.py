"""Input of every solver: stations, the legs between them, and the wheel rotations along the legs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.kinematics import Increments, cut_at, head_pose, join
from mobilecal_cli.model import Extraction, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """Closed loops of eq. 3, one per leg between two stations of one recording.

    Attributes:
        T_v_h: (N, 4, 4) head in the vehicle, from the joint readings.
        T_c_k: (N, 4, 4) board in the left camera.
        points_c: (N, M, 3) triangulated corners, m.
        legs: (L, 2) first and second station of each leg.
        chain: (L,) first leg of the leg's recording; the legs of a recording are consecutive.
        steps: wheel rotations along the legs.
    """

    T_v_h: FloatArray
    T_c_k: FloatArray
    points_c: FloatArray
    legs: IntArray
    chain: IntArray
    steps: Increments

    def select(self, legs: IntArray) -> Loops:
        """The loops of a subset of legs (increasing indices); each leg becomes a recording of its own."""
        return Loops(
            self.T_v_h,
            self.T_c_k,
            self.points_c,
            self.legs[legs],
            np.arange(len(legs)),
            self.steps.select(legs),
        )


def closed_loops(extraction: Extraction) -> Loops:
    """Loops of an extraction: legs join consecutive observations of one recording."""
    observations = extraction.observations
    log = np.array([o.log for o in observations])
    parts, chain = [], []
    legs: list[tuple[int, int]] = []
    for number, track in enumerate(extraction.wheels):
        members = np.flatnonzero(log == number)
        if len(members) < 2:
            continue
        parts.append(cut_at(track, np.array([observations[i].time_ns for i in members])))
        chain.extend([len(legs)] * (len(members) - 1))
        legs.extend(itertools.pairwise(members.tolist()))
    return Loops(
        head_pose(extraction.rig.chain, np.stack([o.joints for o in observations])),
        np.stack([o.T_c_k for o in observations]),
        np.stack([o.points_c for o in observations]),
        np.array(legs, dtype=np.int64).reshape(-1, 2),
        np.array(chain, dtype=np.int64),
        join(parts),
    )
