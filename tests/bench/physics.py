"""Drives in a physics engine (MuJoCo): wheels that slip and sink in, a base that pitches, joints that lag.

Nothing of the motion is computed by this project: the engine integrates a base on two wheels and a ball caster, with a
pan-tilt head driven by position controllers. Only the cameras are simulated here. Needs ``pip install '.[bench]'``.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from mobilecal_cli.model.observations import Corners, Extraction, Observation, WheelTrack
from mobilecal_cli.model.signals import Track
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.simulate.route import plan_route, wheel_speeds
from mobilecal_cli.vision.pose import board_pose, square_from_points, triangulate
from tests.bench.imperfect import LEVELS, level_counts, run_of
from tests.bench.study import Study, head, line
from tests.robots import corners_of, in_cameras, rig_of

RUNS = 10
_STEP_S = 0.002
_EVERY = 5  # steps for one row of the log
_PIXEL_PX, _JOINT_RAD = 0.1, float(np.radians(0.02))
_GAIN = 4.0  # of the wheels' position error, 1/s
_CELL_M, _CELLS = 0.02, 400


@dataclass(frozen=True)
class World:
    """A floor and a base.

    Attributes:
        bumps_m: standard deviation of the floor's height, smooth over 0.15 m.
        wheel: an ellipsoid touches the floor at one point, a cylinder at its edges.
        friction: of the wheels.
        weight_m: how far the base's weight lies before the axle.
        ramp_radps2: largest acceleration of the wheels' targets.
    """

    bumps_m: float = 0.0
    wheel: str = "ellipsoid"
    friction: float = 0.9
    weight_m: float = 0.03
    ramp_radps2: float = 18.0


WORLDS = {
    "plane": World(),
    "bumps of 1.5 mm": World(bumps_m=0.0015),
    "bumps of 3 mm": World(bumps_m=0.003),
    "weight 6 cm before the axle": World(weight_m=0.06),
    "cylinders of 24 mm for wheels": World(wheel="cylinder"),
    "friction 0.3, hard acceleration": World(friction=0.3, ramp_radps2=45.0),
}


def _model(world: World) -> str:
    robot = TICK_ROBOT
    sides = (("right", -1, robot.wheels.radius_right_m), ("left", 1, robot.wheels.radius_left_m))
    contact = f'friction="{world.friction} 0.005 0.0001" condim="4"'
    height = 6 * world.bumps_m
    extent = _CELL_M * _CELLS / 2
    field = f'<hfield name="floor" nrow="{_CELLS}" ncol="{_CELLS}" size="{extent} {extent} {height} 0.1"/>'
    floor = 'type="hfield" hfield="floor"' if height else 'type="plane" size="10 10 0.1"'
    wheels = ""
    for side, sign, radius in sides:
        size = f"{radius} 0.012" if world.wheel == "cylinder" else f"{radius} {radius} 0.012"
        wheels += (
            f'<body pos="0 {sign * robot.wheels.separation_m / 2} {radius}">'
            f'<joint name="{side}" axis="0 1 0" damping="0.02" armature="0.005"/>'
            f'<geom type="{world.wheel}" size="{size}" euler="90 0 0" mass="0.3" {contact} solref="0.004 1" '
            'priority="1"/></body>'
        )
    ghost = 'contype="0" conaffinity="0"'
    return f"""<mujoco><compiler angle="degree"/>
    <option timestep="{_STEP_S}" integrator="implicitfast" cone="elliptic" impratio="10"/>
    <asset>{field if height else ""}</asset>
    <worldbody><geom {floor} {contact}/>
    <body pos="0 0 {0.002 + 0.4 * height}"><freejoint/>
      <geom type="box" size="0.17 0.14 0.06" pos="{world.weight_m} 0 0.14" mass="8" {ghost}/>{wheels}
      <geom type="sphere" size="0.03" pos="0.13 0 0.03" mass="0.1" friction="0.01 0.001 0.0001" priority="2"/>
      <body pos="0.08 0 0.62"><joint name="pan" axis="0 0 1" damping="0.3" armature="0.01"/>
        <geom type="box" size="0.03 0.03 0.03" mass="0.3" {ghost}/>
        <body pos="0 0 0.05"><joint name="tilt" axis="0 1 0" damping="0.3" armature="0.01"/>
          <geom type="box" size="0.03 0.07 0.03" pos="0.04 0 0.02" mass="0.4" {ghost}/></body></body>
    </body></worldbody>
    <actuator><velocity joint="right" kv="3"/><velocity joint="left" kv="3"/>
      <position joint="pan" kp="60" kv="3"/><position joint="tilt" kp="60" kv="3"/></actuator></mujoco>"""


def recorded(world: World, motion: str, stations: int, seed: int) -> Extraction:
    """A drive along a planned route; images at rest, or three for each station of a route in motion."""
    robot, random = TICK_ROBOT, np.random.default_rng([seed, 4])
    route = plan_route(robot, motion, stations=stations, seed=seed)
    model = mujoco.MjModel.from_xml_string(_model(world))
    if world.bumps_m:
        heights = np.random.default_rng([seed, 9]).normal(size=(_CELLS, _CELLS))
        heights = gaussian_filter(heights, 0.15 / _CELL_M, mode="wrap")
        model.hfield_data[:] = np.clip(heights / heights.std() / 6 + 0.5, 0, 1).ravel()
    state = mujoco.MjData(model)
    mujoco.mj_step(model, state, 1000)
    begin, breaks = state.qpos[[7, 8]].copy(), route.drive.breaks_s
    wanted, speed = np.zeros(2), np.zeros(2)
    times, wheels, joints, bases = [], [], [], []
    for k in range(int(route.duration_s / _STEP_S)):
        stretch = min(int(np.searchsorted(breaks, k * _STEP_S, side="right")), len(route.drive.stretches)) - 1
        target = np.array(wheel_speeds(route.drive.stretches[stretch], robot.wheels))
        speed += np.clip(target - speed, -world.ramp_radps2 * _STEP_S, world.ramp_radps2 * _STEP_S)
        wanted += target * _STEP_S
        state.ctrl[:2] = speed + _GAIN * (wanted - (state.qpos[[7, 8]] - begin))
        state.ctrl[2:] = route.joints(np.array([k * _STEP_S]))[0]
        mujoco.mj_step(model, state)
        if k % _EVERY == 0:
            T_w_v = np.eye(4)
            T_w_v[:3, :3] = Rotation.from_quat(state.qpos[[4, 5, 6, 3]]).as_matrix()
            T_w_v[:3, 3] = state.qpos[:3]
            times.append(k * _STEP_S)
            wheels.append(state.qpos[[7, 8]].copy())
            joints.append(state.qpos[[9, 10]].copy())
            bases.append(T_w_v)
    still = len(route.rests_s) > 0
    at_s = np.linspace(1.0, route.duration_s - 1.0, 3 * stations)
    if still:
        at_s = route.rests_s.mean(axis=1) + 0.25
    observations, T_w_k = [], route.T_w_k.copy()
    T_w_k[2, 3] += bases[0][2, 3]
    for k in np.searchsorted(times, at_s).tolist():
        T_c_k = np.linalg.inv(bases[k] @ robot.head_pose(joints[k]) @ robot.T_h_c) @ T_w_k
        seen = _observed(route, T_c_k, random)
        if seen is not None:
            reading = joints[k] + _JOINT_RAD * random.normal(size=2)
            stamp = round(times[k] * 1e9)
            known = (0, len(observations), stamp, still, reading, np.full(2, _JOINT_RAD))
            observations.append(Observation(*known, *seen))
    stamps = np.round(np.array(times[::2]) * 1e9).astype(np.int64)
    ticks = np.floor(np.array(wheels[::2]) / robot.encoder_step_rad) * robot.encoder_step_rad
    return Extraction(
        rig=rig_of(robot, True),
        board=route.board,
        observations=tuple(observations),
        wheels=(WheelTrack.at_same_times(stamps, ticks[:, 0], ticks[:, 1]),),
        rejections=(),
        notes=(),
        logs=(),
        counts={"stations": len(observations), "observations": len(observations)},
        joint_tracks=(tuple(Track(stamps, np.array(joints[::2])[:, j]) for j in range(2)),),
    )


def _observed(route, T_c_k, random):
    """Views, points, board pose, square and misfit of one station; None if a camera does not show the whole board."""
    rig, corners_k = TICK_ROBOT.rig_cameras, corners_of(route)
    seen = []
    for camera, at in zip(rig.each, in_cameras(rig, T_c_k, corners_k), strict=True):
        if at.min() < 0 or np.any(at > [camera.width, camera.height]):
            return None
        seen.append(at + _PIXEL_PX * random.normal(size=at.shape))
    views = tuple(Corners(at, _PIXEL_PX, 1) for at in seen)
    points, found = triangulate(rig, views), board_pose(rig, corners_k, views, T_c_k)
    square_m = square_from_points(points.points_c, route.board.grid())
    return views, points.points_c, points.points_cov, found.T_c_k, found.T_c_k_cov, square_m, found.rms_px


def main(asked: Study) -> None:
    """All worlds, at rest and in motion."""
    head(
        "", "runs", "mean NEES / 6 of the camera", "mean error of the separation (%)", "in its sigmas", *LEVELS,
        "beyond five sigmas", title=f"MuJoCo {mujoco.__version__}",
    )  # fmt: skip
    robot = TICK_ROBOT
    for name in asked.chosen(WORLDS):
        for motion, stations in (("standard", 20), ("moving", 27)):
            worlds = (recorded(WORLDS[name], motion, stations, seed) for seed in range(asked.runs))
            results = [run_of(extraction, robot) for extraction in worlds]
            camera = np.nanmean([(r.nees[0] + r.nees[1]) / 2 for r in results])
            wide = np.nanmean([100 * r.error[8] / robot.wheels.separation_m for r in results])
            sigmas, beyond = (
                np.nanmean([r.error[8] / r.std[8] for r in results]),
                sum(r.beyond for r in results),
            )
            cells = (f"{camera:.2f}", f"{wide:+.2f}", f"{sigmas:+.1f}", *level_counts(results), beyond)
            line(f"{name}, {motion}", asked.runs, *cells)
