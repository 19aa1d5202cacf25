"""A calibration as a scene over time: frames, images with corners, and what was rejected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import (
    Board,
    CalibratedRobot,
    CameraRig,
    Extraction,
    FloatArray,
    HeadChain,
    IntArray,
    Residuals,
)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of base and head in one recording.

    Attributes:
        time_ns: (n,) increasing.
        T_w_v: (n, 4, 4) base in the world (the base at the first station), by dead reckoning.
        T_v_h: (n, 4, 4) head in the base.
    """

    time_ns: IntArray
    T_w_v: FloatArray
    T_v_h: FloatArray


class Unused(NamedTuple):
    """Something that was not used, with the interval that it concerns.

    Attributes:
        start_ns, end_ns: the same for a moment.
        what: a few words, the same for all of a kind.
        text: a whole sentence, or the numbers.
    """

    start_ns: int
    end_ns: int
    what: str
    text: str


class Frames(NamedTuple):
    """Names of the frames, of `cameras` by camera. All differ; a camera on the base has it as its head."""

    world: str
    base: str
    head: str
    cameras: Mapping[str, str]
    board: str


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that a viewer shows.

    Attributes:
        robot: the calibration.
        extraction: its measurements.
        cameras: as estimated, lens corrections as part of the distortion models.
        board: with its square size.
        motions: recording → motion in it.
        station_names: of the observations, for people.
        residuals: of the calibration.
        T_w_c: (N, 4, 4) first camera in the world at each observation.
        legs: observation → the leg that predicts its corners, of those that the estimate uses.
        images: observation → camera → JPEG.
        unused: in order of time.
        names: of the frames.
    """

    robot: CalibratedRobot
    extraction: Extraction
    cameras: CameraRig
    board: Board
    motions: Mapping[int, Motion]
    station_names: Sequence[str]
    residuals: Residuals
    T_w_c: FloatArray
    legs: Mapping[int, int]
    images: Mapping[int, Mapping[str, bytes]]
    unused: tuple[Unused, ...]
    names: Frames

    def fixed_frames(self) -> list[tuple[str, str, FloatArray]]:
        """Parent, child and child coordinates to parent coordinates (4, 4) of the frames on the head.

        The reference camera is on the head, exactly as in params.yaml; the other cameras are on it.
        """
        names, cameras = self.names, self.cameras
        reference, T_reference_c = names.cameras[cameras.reference], se3.inverse(cameras.T_c_reference)
        others = [
            (reference, names.cameras[name], T_reference_c @ T)
            for name, T in zip(cameras.names, cameras.T_c_each, strict=True)
            if name != cameras.reference
        ]
        return [(names.head, reference, self.robot.T_parent_child), *others]


def frames_of(chain: HeadChain, cameras: CameraRig) -> Frames:
    """The robot's own names; "world" and "board", or longer ones if the robot has these.

    Raises:
        ConfigError: base and head have the same name.
    """
    if chain.base_frame == chain.head_frame and chain.links:
        raise ConfigError(
            f"base and head frame are both {chain.base_frame!r}", "name them in rig.yaml and calibrate again"
        )
    taken = [chain.base_frame, chain.head_frame]

    def free(name: str, other: str) -> str:
        taken.append(other if name in taken else name)
        return taken[-1]

    each = {
        name: free(camera.frame_id, f"{name}_camera")
        for name, camera in zip(cameras.names, cameras.each, strict=True)
    }
    world, board = free("world", "mobilecal_world"), free("board", "mobilecal_board")
    return Frames(world, chain.base_frame, chain.head_frame, each, board)


def dark_squares(board: Board) -> FloatArray:
    """(n, 4, 3) corners of the dark squares (aprilgrid: of the tags) in the board's frame, m."""
    square_m = board.square_m or 0.0
    if board.markers is not None and board.markers.kind == "aprilgrid":
        return np.asarray(board.grid().reshape(-1, 4, 3) * square_m)
    row, column = np.divmod(np.arange((board.columns + 1) * (board.rows + 1)), board.columns + 1)
    dark = (row + column) % 2 == 0
    low = np.stack([column[dark] - 1, row[dark] - 1, np.zeros(int(dark.sum()))], axis=1)
    return np.asarray((low[:, None] + np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])) * square_m)
