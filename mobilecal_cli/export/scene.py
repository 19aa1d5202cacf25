"""A calibration as a scene over time: frames, images with corners, and what was rejected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.improved import improved_cameras
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import CameraRig
from mobilecal_cli.model.solution import Residuals


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


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a viewer shows.

    Attributes:
        robot: the calibration.
        extraction: its measurements.
        motions: recording → motion in it.
        residuals: of the calibration.
        legs: observation → the leg that predicts its corners, of those that the estimate uses.
        images: observation → camera → JPEG.
        unused: in order of time.
    """

    robot: CalibratedRobot
    extraction: Extraction
    motions: Mapping[int, Motion]
    residuals: Residuals
    legs: Mapping[int, int]
    images: Mapping[int, Mapping[str, bytes]]
    unused: tuple[Unused, ...]

    @cached_property
    def cameras(self) -> CameraRig:
        """As estimated, lens corrections as part of the distortion models."""
        return improved_cameras(self.extraction.rig, self.robot.constants)[0]

    @cached_property
    def names(self) -> Frames:
        """The robot's own names of the frames; "world" and "board", or longer ones if the robot has these.

        Raises:
            ConfigError: base and head have the same name.
        """
        chain, cameras = self.extraction.rig.chain, self.extraction.rig.cameras
        if chain.base_frame == chain.head_frame and chain.links:
            raise ConfigError(
                f"base and head frame are both {chain.base_frame!r}",
                "name them in rig.yaml and calibrate again",
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

    def station_name(self, observation: int) -> str:
        """Name of the station of an observation, for people."""
        o = self.extraction.observations[observation]
        return self.extraction.station_name(o.log, o.station)

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
