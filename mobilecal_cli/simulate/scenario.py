"""Description of a simulation, and the world that its recording shows, with the ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import SIDES, Board, CameraRig, Markers
from mobilecal_cli.simulate.render import BoardRenderer
from mobilecal_cli.simulate.robot import (
    JOINT_NOISE_RAD,
    JOINT_RATE_HZ,
    ROBOTS,
    TICKS_PER_REVOLUTION,
    SimulatedRobot,
)
from mobilecal_cli.simulate.route import CHECKERBOARD, Route, base_in_world, plan_route
from mobilecal_cli.targets import BoardKind, Container, Motion, Pictures

PRINTED: dict[BoardKind, Board] = {
    "charuco": Board(15, 11, 0.08, Markers("charuco", "DICT_5X5_1000", 0.75)),
    "aprilgrid": Board(9, 7, 0.11, Markers("aprilgrid", "DICT_APRILTAG_36h11", 0.3, border_bits=2)),
}
PIXEL_NOISE_GREY = 2.0  # sigma of the sensor noise, gray levels
BLUR_PX = 0.6  # sigma of the lens blur
WHEEL_NOISE_RAD_PER_SQRT_RAD = 0.003  # sigma of a wheel's rotation over one radian
_MOVING_HZ = 10.0  # stereo pairs of a recording without rests
_REST_MARGIN_S = 0.3  # at both ends of a rest, without a stereo pair


@dataclass(frozen=True, slots=True)
class Scenario:
    """Description of a simulated recording.

    Attributes:
        robot: a name in `ROBOTS`.
        motion: motion of base and head.
        seed: of every random choice.
        stations: number of stops; a moving route takes three seconds per station.
        container: format of the recording.
        pictures: format of the images.
        pictures_per_rest: stereo pairs per stop.
        board: the checkerboard that the route keeps in view, with known square size.
        kind: printed board: that checkerboard, or a larger board with markers from `PRINTED` at the same center,
            which many images show in part.
        exact: no noise, encoders of unlimited resolution, lossless images.
        camera_late_s: delay of the camera stamps relative to joints and wheels, s.
    """

    robot: str = "paper"
    motion: Motion = "standard"
    seed: int = 0
    stations: int = 12
    container: Container = "mcap"
    pictures: Pictures = "jpeg"
    pictures_per_rest: int = 2
    board: Board = CHECKERBOARD
    kind: BoardKind = "checkerboard"
    exact: bool = False
    camera_late_s: float = 0.0

    def unrecorded(self) -> dict[str, object]:
        """Keys of rig.yaml for what the recording does not contain, and their values."""
        robot, board = ROBOTS[self.robot], PRINTED.get(self.kind, self.board)
        keys: dict[str, object] = {}
        if (markers := board.markers) is not None:
            share = "marker_share" if markers.kind == "charuco" else "gap_share"
            keys = {"kind": markers.kind, "columns": board.columns, "rows": board.rows, share: markers.share}
            keys |= {"dictionary": markers.dictionary, "border_bits": markers.border_bits}
        if markers is not None or len(robot.infos) == 1:
            keys["square_m"] = board.square_m
        settings = {f"board.{key}": value for key, value in keys.items()}
        if robot.wheel_signal == "ticks":
            settings |= {f"wheels.{side}.ticks_per_revolution": TICKS_PER_REVOLUTION for side in SIDES}
        return settings

    def plan(self) -> tuple[SimulatedRobot, Route]:
        """The robot and its route.

        Raises:
            ConfigError: no route keeps the board in view.
        """
        robot = ROBOTS[self.robot]
        route = plan_route(robot, self.motion, self.stations, self.board, self.seed)
        if self.kind == "checkerboard":
            return robot, route
        printed = PRINTED[self.kind]
        shift = np.eye(4)
        shift[:3, 3] = self.board.grid().mean(axis=0) * (self.board.square_m or 1.0)
        shift[:3, 3] -= printed.grid().mean(axis=0) * (printed.square_m or 1.0)
        return robot, replace(route, board=printed, T_w_k=route.T_w_k @ shift)


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What a recording shows: a robot and a board that are as described, on an even floor.

    Attributes:
        scenario, robot, route: what was planned.
    """

    scenario: Scenario
    robot: SimulatedRobot
    route: Route

    @property
    def cameras(self) -> CameraRig:
        """The cameras of the images."""
        return self.robot.rig_cameras

    def renderers(self, random: np.random.Generator) -> list[BoardRenderer]:
        """A renderer of the board for each camera."""
        return [BoardRenderer(camera, self.route.board, BLUR_PX, random) for camera in self.cameras.each]

    def camera_poses(self, times_s: FloatArray) -> FloatArray:
        """T_w_c of the first camera at given times, (n, 4, 4)."""
        heads = np.array([self.robot.head_pose(joints) for joints in self.route.joints(times_s)])
        return np.asarray(base_in_world(self.route.drive.poses(times_s)) @ heads @ self.robot.T_h_c)

    def picture_times_s(self) -> FloatArray:
        """Times of the stereo pairs, s: inside the rests; without rests, ten per second."""
        if not len(self.route.rests_s):
            return np.arange(0.5, self.route.duration_s - 0.5, 1 / _MOVING_HZ)
        begin, end = self.route.rests_s.T
        each = self.scenario.pictures_per_rest
        return np.linspace(begin + _REST_MARGIN_S, end - _REST_MARGIN_S, each, axis=1).ravel()

    def stamps_s(self, times_s: FloatArray) -> FloatArray:
        """Stamps of images taken at given times, (n,)."""
        return times_s + self.scenario.camera_late_s

    def state_times_s(self) -> FloatArray:
        """Times of the joint states; exact recordings sample every change of speed: angles are linear in between."""
        times_s = np.arange(0, self.route.duration_s, 1 / JOINT_RATE_HZ)
        breaks_s = self.route.drive.breaks_s
        return np.unique(np.concatenate([times_s, breaks_s])) if self.scenario.exact else times_s

    def joints(self, times_s: FloatArray) -> FloatArray:
        """(n, J) joint readings without noise, rad."""
        return self.route.joints(times_s)

    def wheels(self, times_s: FloatArray, random: np.random.Generator) -> FloatArray:
        """(n, 2) readings of the right and left encoder, rad."""
        angles = self.route.drive.wheel_angles(times_s, self.robot.wheels, self.robot.slip)
        if self.scenario.exact:
            return angles
        return self.read(angles, WHEEL_NOISE_RAD_PER_SQRT_RAD, random)

    def read(self, angles: FloatArray, sigma: float, random: np.random.Generator) -> FloatArray:
        """Wheel rotations (n, k) with a slip of some rad per sqrt(rad), as the encoders resolve them, rad."""
        change = np.diff(angles, axis=0, prepend=angles[:1])
        error = random.normal(size=change.shape) * sigma * np.sqrt(np.abs(change))
        return self.stepped(angles + np.cumsum(error, axis=0))

    def stepped(self, angles: FloatArray) -> FloatArray:
        """Wheel rotations as the encoders resolve them, rad."""
        return np.asarray(np.floor(angles / self.robot.encoder_step_rad) * self.robot.encoder_step_rad)

    def truth(self) -> str:
        """Text of truth.yaml: the nine parameters under the keys of params.yaml, and the stations."""
        robot, route = self.robot, self.route
        noisy = 0.0 if self.scenario.exact else 1.0
        times_s = route.rests_s.mean(axis=1)
        return rendered(
            "truth.yaml",
            scenario=self.scenario,
            robot=robot,
            route=route,
            translation_m=robot.T_h_c[:3, 3],
            quaternion_xyzw=se3.quaternion_xyzw(robot.T_h_c[:3, :3]),
            noise={
                "pixel_noise_grey": noisy * PIXEL_NOISE_GREY,
                "blur_px": BLUR_PX,
                "wheel_noise_rad_per_sqrt_rad": noisy * WHEEL_NOISE_RAD_PER_SQRT_RAD,
                "encoder_step_rad": noisy * robot.encoder_step_rad,
                "joint_noise_rad": noisy * JOINT_NOISE_RAD,
            },
            stations=list(zip(times_s, route.drive.poses(times_s), route.joints(times_s), strict=True)),
        )
