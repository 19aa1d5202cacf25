"""Robots with other cameras than a stereo pair, their descriptions, and a stereo recording seen with one camera."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners, Extraction, Observation
from mobilecal_cli.model.rig import (
    SIDES,
    CameraRig,
    FixedLink,
    HeadChain,
    JointLink,
    Nominal,
    Rig,
    Side,
    Sources,
    WheelSource,
)
from mobilecal_cli.simulate.robot import (
    FIXED_CAMERA_ROBOT,
    RGBD_ROBOT,
    SKID_STEER_ROBOT,
    TICK_BITS,
    TICK_ROBOT,
    TICKS_PER_REVOLUTION,
    SimulatedRobot,
    pixels,
    pose,
)
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.vision import Miss
from mobilecal_cli.vision.pose import pose_from_one


def chain_of(robot: SimulatedRobot) -> HeadChain:
    """The head chain of a simulated robot as the solver has it."""
    links: list[FixedLink | JointLink] = []
    for joint in robot.joints:
        links.append(FixedLink(pose(joint.xyz_m, Rotation.from_euler("xyz", joint.rpy_rad))))
        if joint.name:
            links.append(JointLink(joint.name, np.array(joint.axis)))
    return HeadChain(robot.base_frame, robot.head_frame, tuple(links), robot.pan, robot.tilt)


def rig_of(robot: SimulatedRobot, nominal: bool = True) -> Rig:
    """The description of a simulated robot for a calibration; `nominal`: with its nominal values."""
    prior = Nominal(robot.T_h_c_nominal, robot.nominal_wheels) if nominal else Nominal()
    resolved = dict.fromkeys(("cameras", "head", "wheels", "nominal"), "default")
    return Rig(robot.rig_cameras, chain_of(robot), prior, sources_of(robot), resolved)


def sources_of(robot: SimulatedRobot, compressed: bool = False) -> Sources:
    """The topics of a simulated robot's recordings."""
    suffix = "/compressed" if compressed else ""
    spaces = {name: robot.camera_namespace(name) for name in robot.rig_cameras.names}
    return Sources(
        image={name: f"{space}/image_raw{suffix}" for name, space in spaces.items()},
        info={name: f"{space}/camera_info" for name, space in spaces.items()},
        joints=dict.fromkeys(chain_of(robot).joints, "/joint_states"),
        wheels={side: _wheel_source(robot, side) for side in SIDES},
    )


def _wheel_source(robot: SimulatedRobot, side: Side) -> WheelSource:
    if robot.wheel_signal == "ticks":
        return WheelSource(f"/wheel_ticks/{side}", None, "data", float(TICKS_PER_REVOLUTION), TICK_BITS)
    if robot.wheel_signal == "odometry":
        return WheelSource("/odom", baked_in=robot.nominal_wheels, assumed=True)
    first, *others = (WheelSource("/joint_states", name) for name in robot.wheel_joints[side])
    return replace(first, others=tuple(others))


def corners_of(route: Route) -> FloatArray:
    """(M, 3) the board's corners in the board frame, m."""
    return route.board.grid() * (route.board.square_m or 0.0)


def in_cameras(rig: CameraRig, T_c_k: FloatArray, points_k: FloatArray) -> list[FloatArray]:
    """(M, 2) px of points (M, 3) of the board frame, for each camera, as the simulator shows them."""
    points_c = se3.act(T_c_k, points_k)
    return [
        pixels(camera, se3.act(se3.inverse(T_c_camera), points_c))
        for camera, T_c_camera in zip(rig.each, rig.T_c_each, strict=True)
    ]


def true_nominal(robot: SimulatedRobot) -> Nominal:
    """Nominal values that are those of a simulated robot."""
    return Nominal(robot.T_h_c @ robot.rig_cameras.T_c_reference, robot.wheels)


def _panning(robot: SimulatedRobot, name: str) -> SimulatedRobot:
    """The robot with a head that only pans."""
    return replace(robot, name=name, joints=robot.joints[:1], tilt="")


def _with_one_camera(robot: SimulatedRobot, name: str) -> SimulatedRobot:
    """The robot with its first camera alone."""
    return replace(robot, name=name, infos=robot.infos[:1], mounted={"camera": np.eye(4)})


@cache
def one_on_pan_tilt() -> SimulatedRobot:
    """A single camera on a pan-tilt head."""
    return _with_one_camera(TICK_ROBOT, "mono")


@cache
def one_that_pans() -> SimulatedRobot:
    """A single camera on a head that only pans."""
    return _panning(one_on_pan_tilt(), "pan")


@cache
def pair_that_pans() -> SimulatedRobot:
    """A stereo pair on a head that only pans."""
    return _panning(TICK_ROBOT, "pan_pair")


def _three(robot: SimulatedRobot) -> SimulatedRobot:
    """Three cameras: two of them 0.2 m apart, the third turned away by 16 degrees."""
    left, right = TICK_ROBOT.infos
    beside = pose((0.2, 0.01, -0.02), Rotation.from_euler("xyz", (1.0, -2.0, 0.5), degrees=True))
    aside = pose((-0.1, 0.0, 0.03), Rotation.from_euler("xyz", (0.0, -16.0, 1.0), degrees=True))
    mounted = {"front": np.eye(4), "beside": beside, "aside": aside}
    longer = left.K * [[1.1, 1.0, 1.0], [1.0, 1.1, 1.0], [1.0, 1.0, 1.0]]
    infos = (left, right, replace(left, frame_id="aside_optical", K=longer))
    return replace(robot, name=f"{robot.name}_three", infos=infos, mounted=mounted)


@cache
def three_on_pan_tilt() -> SimulatedRobot:
    """Three cameras on a pan-tilt head."""
    return _three(TICK_ROBOT)


@cache
def three_that_pan() -> SimulatedRobot:
    """Three cameras on a head that only pans."""
    return _three(pair_that_pans())


@cache
def three_on_the_base() -> SimulatedRobot:
    """Three cameras on the base."""
    return _three(FIXED_CAMERA_ROBOT)


@cache
def rgbd_with_odometry() -> SimulatedRobot:
    """An RGB-D camera on the base, and the odometry of the driver in place of the wheels."""
    return replace(RGBD_ROBOT, name="rgbd_odometry", wheel_signal="odometry")


@cache
def skid_steer_that_pans() -> SimulatedRobot:
    """Four wheel joints, and a single camera on a head that only pans."""
    return _panning(_with_one_camera(SKID_STEER_ROBOT, "one_camera"), "skid_steer_pan")


#: (number of cameras, chain) → the robot.
CONFIGURATIONS = {
    (1, "none"): RGBD_ROBOT,
    (1, "pan"): one_that_pans(),
    (1, "pan-tilt"): one_on_pan_tilt(),
    (2, "none"): FIXED_CAMERA_ROBOT,
    (2, "pan"): pair_that_pans(),
    (2, "pan-tilt"): TICK_ROBOT,
    (3, "none"): three_on_the_base(),
    (3, "pan"): three_that_pan(),
    (3, "pan-tilt"): three_on_pan_tilt(),
}


def hidden(pixels: FloatArray) -> Corners:
    """No corner in view, in place of some."""
    return Corners(np.zeros_like(pixels), 1.0, 0, np.zeros(len(pixels), dtype=np.bool_))


def _seen_by(o: Observation, rig: CameraRig, board: FloatArray, k: int) -> Observation:
    """An observation with the board's pose from the corners of camera k alone, the only one of a rig."""
    found = pose_from_one(rig, board, o.views[k])
    assert not isinstance(found, Miss)
    points_c, rms_px = se3.act(found.T_c_k[None], board)[0], found.rms_px
    return replace(o, points_c=points_c, T_c_k=found.T_c_k, T_c_k_cov=found.T_c_k_cov, reprojection_px=rms_px)


def with_one_view(extraction: Extraction, camera_of: Mapping[int, int]) -> Extraction:
    """The same, with the board in one camera alone at some stations: index of the station → index of that camera."""
    rig, board = extraction.rig.cameras, extraction.board.grid() * (extraction.board.square_m or 0.0)
    observations = list(extraction.observations)
    for i, k in camera_of.items():
        o = observations[i]
        views = tuple(view if other == k else hidden(o.views[k].pixels) for other, view in enumerate(o.views))
        observations[i] = replace(_seen_by(o, rig.some([k]), board, k), views=views)
    return replace(extraction, observations=tuple(observations))


def alone(extraction: Extraction, k: int) -> Extraction:
    """What camera k alone measures of a recording: its corners, and the board's pose from them."""
    cameras = extraction.rig.cameras
    each, R_rect = (cameras.each[k],), (cameras.R_rect[k],)
    rig = CameraRig(("camera",), each, (np.eye(4),), cameras.rectified, R_rect, "camera")
    board, observations = extraction.board.grid() * extraction.board.square_m, []
    for o in extraction.observations:
        seen = _seen_by(o, rig, board, k)
        observations.append(replace(seen, views=(o.views[k],), points_cov=np.zeros_like(o.points_cov)))
    nominal = extraction.rig.nominal
    if nominal.T_h_reference is not None:
        T = nominal.T_h_reference @ se3.inverse(cameras.T_c_reference) @ cameras.T_c_each[k]
        nominal = replace(nominal, T_h_reference=T)
    rig = replace(extraction.rig, cameras=rig, nominal=nominal)
    return replace(extraction, rig=rig, observations=tuple(observations))
