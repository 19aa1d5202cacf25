"""A made-up answer that hangs together: a robot, a board, stations, and parameters a little off the truth.

No solver runs here; the "solution" is the truth with small errors, so every derived number is plausible.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import (
    Board,
    Camera,
    Corners,
    Extraction,
    FixedLink,
    FloatArray,
    HeadChain,
    JointLink,
    LinearEstimate,
    LogSource,
    Nominal,
    Observation,
    Parameters,
    Provenance,
    Refinement,
    Rejection,
    Residuals,
    Rig,
    Snapshot,
    Solution,
    Sources,
    StereoRig,
    WheelGeometry,
    WheelSource,
    WheelTrack,
)

BOARD = Board(9, 6, 0.08)
WHEELS = WheelGeometry(0.2233, 0.22767, 0.5087)
K = np.array([[550.0, 0, 320], [0, 550, 240], [0, 0, 1]])
T_C_R = se3.transform(np.eye(3), np.array([0.12, 0, 0]))
# The head looks along its own x axis; the optical frame looks along z.
T_H_C = se3.transform(
    np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ se3.exp_so3(np.array([0.02, -0.03, 0.01])),
    np.array([0.0136, -0.06434, -0.07077]),
)
_Z, _Y = np.array([0.0, 0, 1]), np.array([0.0, 1, 0])


def make_rig(rectified: bool = False, nominal: Nominal | None = None) -> Rig:
    def camera(name: str) -> Camera:
        return Camera(name, 640, 480, K, np.zeros(0), "none")

    R_rect = se3.exp_so3(np.array([0.01, -0.02, 0.005])) if rectified else np.eye(3)
    stereo = StereoRig(
        camera("stereo_left_optical"), camera("stereo_right_optical"), T_C_R, rectified, R_rect, R_rect
    )
    chain = HeadChain(
        "base_link",
        "head_link",
        (
            FixedLink(se3.transform(np.eye(3), np.array([0.05, 0, 0.9]))),
            JointLink("head_pan_joint", _Z),
            FixedLink(se3.transform(np.eye(3), np.array([0.02, 0, 0.06]))),
            JointLink("head_tilt_joint", _Y),
        ),
        "head_pan_joint",
        "head_tilt_joint",
    )
    sources = Sources(
        {"left": "/stereo/left/image_raw", "right": "/stereo/right/image_raw"},
        {"left": "/stereo/left/camera_info", "right": "/stereo/right/camera_info"},
        ("/joint_states",),
        {
            "left": WheelSource("/joint_states", joint="wheel_left_joint"),
            "right": WheelSource("/wheel_ticks", field="right.ticks", ticks_per_revolution=4096.0, bits=16),
        },
    )
    settled = {"board.columns": "log", "cameras.left.image": "log", "cameras.rectified": "default"}
    return Rig(stereo, chain, nominal or Nominal(), sources, settled)


def head(pan_rad: float, tilt_rad: float) -> FloatArray:
    T = se3.transform(np.eye(3), np.array([0.05, 0, 0.9]))
    T = T @ se3.transform(se3.rotation_about(_Z, np.array(pan_rad)), np.zeros(3))
    T = T @ se3.transform(np.eye(3), np.array([0.02, 0, 0.06]))
    return np.asarray(T @ se3.transform(se3.rotation_about(_Y, np.array(tilt_rad)), np.zeros(3)))


def project(points_c: FloatArray, right: bool = False) -> FloatArray:
    p = se3.act(se3.inverse(T_C_R), points_c) if right else points_c
    return np.asarray(p[..., :2] / p[..., 2:] * 550 + K[:2, 2])


def _stations(rng: np.random.Generator, n: int, log: int) -> tuple[list[FloatArray], FloatArray]:
    """Base poses on a gentle weave in front of the board and head joints that keep it in view."""
    poses, joints = [], []
    board_w = np.array([2.6, 0.1 * log, 1.0])
    for i in range(n):
        heading = 0.35 * math.sin(1.7 * i + log)
        at = np.array([0.08 * i, 0.35 * math.sin(0.9 * i), 0])
        pose = se3.transform(se3.rotation_z(np.array(heading)), at)
        d = se3.act(se3.inverse(pose), board_w[None])[0] - np.array([0.07, 0, 0.96])
        pan = math.atan2(d[1], d[0]) + rng.normal(0, 0.12)
        tilt = -math.atan2(d[2], math.hypot(d[0], d[1])) + rng.normal(0, 0.08)
        poses.append(pose)
        joints.append([pan, tilt])
    return poses, np.array(joints)


def _board_pose() -> FloatArray:
    """Board to world: it faces the robot, x to the robot's right, y down, a little turned."""
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]) @ se3.exp_so3(np.array([0.1, 0.2, 0.05]))
    return np.asarray(se3.transform(R, np.array([2.6, 0.32, 1.2])))


def _observation(
    rng: np.random.Generator, log: int, i: int, T_w_v: FloatArray, joints: FloatArray
) -> Observation:
    T_c_k = se3.inverse(T_w_v @ head(*joints) @ T_H_C) @ _board_pose()
    truth = se3.act(T_c_k, BOARD.grid() * 0.08)
    z = truth[:, 2]
    sigma = np.stack([0.0003 * z, 0.0003 * z, 0.0009 * z**2], axis=-1)
    corners = [project(truth, right) + rng.normal(0, 0.05, (BOARD.corners, 2)) for right in (False, True)]
    return Observation(
        log=log,
        station=i,
        time_ns=1_433_160_000_000_000_000 + (log * 1000 + i * 6) * 1_000_000_000,
        at_rest=True,
        joints=joints,
        joints_std=np.full(2, 1e-4),
        left=Corners(corners[0], 0.03, 5),
        right=Corners(corners[1], 0.03, 5),
        points_c=truth + rng.normal(0, 1, truth.shape) * sigma,
        points_cov=np.einsum("mi,ij->mij", sigma**2, np.eye(3)),
        T_c_k=se3.exp(rng.normal(0, 5e-4, 6)) @ T_c_k,
        T_c_k_cov=np.eye(6) * 25e-8,
        square_m=0.08 + rng.normal(0, 2e-4),
        reprojection_px=float(0.09 + 0.03 * rng.random()),
    )


def _track(poses: list[FloatArray], log: int) -> WheelTrack:
    """Each leg is a turn, a straight stretch and a turn, inside the six seconds between two stations."""
    t0 = 1_433_160_000_000_000_000 + log * 1000 * 1_000_000_000
    times, turns, ways = [t0], [0.0], [0.0]
    for i, (a, b) in enumerate(pairwise(poses)):
        d = se3.inverse(a) @ b
        bearing = math.atan2(d[1, 3], d[0, 3])
        length = math.hypot(d[0, 3], d[1, 3])
        if abs(bearing) > math.pi / 2:
            bearing, length = math.remainder(bearing + math.pi, math.tau), -length
        rest = math.atan2(d[1, 0], d[0, 0]) - bearing
        for k, (turn, way) in enumerate([(bearing, 0.0), (0.0, length), (rest, 0.0), (0.0, 0.0)]):
            times.append(t0 + int((6 * i + (2, 3, 4, 6)[k]) * 1e9))
            turns.append(turns[-1] + turn)
            ways.append(ways[-1] + way)
    turned, driven, b = np.array(turns), np.array(ways), WHEELS.separation_m
    return WheelTrack.at_same_times(
        np.array(times),
        (driven + turned * b / 2) / WHEELS.radius_right_m,
        (driven - turned * b / 2) / WHEELS.radius_left_m,
    )


def make_extraction(n: int = 12, logs: int = 1, rig: Rig | None = None, seed: int = 0) -> Extraction:
    rng = np.random.default_rng(seed)
    observations, tracks = [], []
    for log in range(logs):
        poses, joints = _stations(rng, n, log)
        tracks.append(_track(poses, log))
        observations += [_observation(rng, log, i, poses[i], joints[i]) for i in range(n)]
    return Extraction(
        rig=rig or make_rig(),
        board=BOARD,
        observations=tuple(observations),
        wheels=tuple(tracks),
        rejections=(
            Rejection("stations", "the base moved", "0.021 rad in 0.4 s", 1_433_160_031_000_000_000),
            Rejection("vision", "board partly hidden", "41 of 54 corners", 1_433_160_040_000_000_000, 12),
            Rejection("vision", "board partly hidden", "48 of 54 corners", 1_433_160_046_000_000_000, 13),
        ),
        notes=("/joint_states: 3 messages share a stamp with the one before; the first was kept.",),
        logs=tuple(LogSource(f"robot_{log}.mcap", f"{log:x}" * 64) for log in range(logs)),
        counts={"stations": n * logs + 3, "pictures": 10 * n * logs},
    )


def _perturbed(parameters: Parameters, twist: FloatArray, scale: tuple[float, float, float]) -> Parameters:
    w = parameters.wheels
    return Parameters(
        parameters.T_h_c @ se3.exp(twist),
        WheelGeometry(w.radius_right_m * scale[0], w.radius_left_m * scale[1], w.separation_m * scale[2]),
    )


def make_residuals(extraction: Extraction, T_h_c: FloatArray, seed: int = 1) -> Residuals:
    """Residuals of a head-eye transform on true base poses with a little odometry noise."""
    rng = np.random.default_rng(seed)
    seen = extraction.observations
    T_w_v = []
    for o in seen:
        truth = _board_pose() @ se3.inverse(se3.inverse(se3.inverse(head(*o.joints) @ T_H_C)) @ o.T_c_k)
        noise = se3.exp(np.array([0, 0, rng.normal(0, 0.002), *rng.normal(0, 0.002, 2), 0]))
        T_w_v.append(truth @ noise)
    first = {o.log: se3.inverse(T_w_v[i]) for i, o in reversed(list(enumerate(seen)))}
    T_w_v = [first[o.log] @ T for o, T in zip(seen, T_w_v, strict=True)]
    T_w_c = [T @ head(*o.joints) @ T_h_c for o, T in zip(seen, T_w_v, strict=True)]
    legs = [(i, i + 1) for i in range(len(seen) - 1) if seen[i].log == seen[i + 1].log]
    rms, left, right, px = [], [], [], []
    for i, j in legs:
        carried = se3.act(se3.inverse(T_w_c[i]) @ T_w_c[j], seen[j].points_c)
        rms.append(float(np.sqrt(np.mean(np.sum((carried - seen[i].points_c) ** 2, axis=-1)))))
        left.append(project(carried))
        right.append(project(carried, right=True))
        d = np.concatenate([left[-1] - seen[i].left.pixels, right[-1] - seen[i].right.pixels])
        px.append(float(np.sqrt(np.mean(np.sum(d**2, axis=-1)))))
    m = extraction.board.corners
    return Residuals(
        legs=np.array(legs, dtype=np.int64).reshape(-1, 2),
        leg_point_rms_m=np.array(rms),
        predicted_left_px=np.array(left).reshape(-1, m, 2),
        predicted_right_px=np.array(right).reshape(-1, m, 2),
        leg_reprojection_px=np.array(px),
        T_w_v=np.array(T_w_v).reshape(-1, 4, 4),
        T_w_k=np.array([T @ o.T_c_k for o, T in zip(seen, T_w_c, strict=True)]).reshape(-1, 4, 4),
    )


def make_solution(extraction: Extraction, refined: bool = True) -> Solution:
    truth = Parameters(T_H_C, WHEELS)
    linear = _perturbed(
        truth, np.array([0.004, -0.006, 0.005, 0.008, 0.003, -0.001]), (0.9985, 0.9825, 0.9975)
    )
    rounds = [
        _perturbed(linear, np.array([0.1, -0.2, 0.1, 0.1, 0.05, 0.02]) * 0.12**k, (1 + 0.3 * 0.1**k,) * 3)
        for k in range(1, 5)
    ]
    estimate = LinearEstimate(
        parameters=linear,
        history=(*rounds, linear),
        rounds_to_tolerance=3,
        point_rms_m=0.01094,
        start_ratios=np.array([0.44, -0.44]),
        start_from="grid",
        rival_point_rms_m=math.inf,
    )
    best = _perturbed(truth, np.array([2e-4, -3e-4, 1e-4, 5e-4, -3e-4, 1e-4]), (1.0004, 0.9997, 1.0002))
    residuals = make_residuals(extraction, best.T_h_c)
    legs = residuals.leg_point_rms_m
    rms = float(np.sqrt(np.mean(legs**2))) if len(legs) else 0.0
    refinement = Refinement("lm", best, np.array([0.01094, rms * 1.04, rms * 1.001, rms]), rms, 31)
    answer = best if refined else linear
    return Solution(
        method="lm" if refined else "linear",
        parameters=answer,
        cameras=extraction.rig.cameras,
        linear=estimate,
        refinement=refinement if refined else None,
        residuals=residuals,
        point_rms_m=rms if refined else 0.01094,
        reprojection_rms_px=float(np.sqrt(np.mean(residuals.leg_reprojection_px**2))) if len(legs) else 0.0,
        motion={"pan_range_deg": 61.2, "tilt_range_deg": 24.9, "turned_deg": 143.0, "driven_m": 2.31},
    )


def make_provenance(extraction: Extraction) -> Provenance:
    return Provenance(
        version="0.1.0",
        created="2015-06-01T12:00:00Z",
        method="lm",
        logs=extraction.logs,
        config={
            "board": {
                "columns": {"value": 9, "settled_by": "log"},
                "rows": {"value": 6, "settled_by": "log"},
            },
            "cameras": {"left.image": {"value": "/stereo/left/image_raw", "settled_by": "log"}},
        },
    )


def _picture(corners: FloatArray, rng: np.random.Generator) -> bytes:
    """The board drawn from its corners (one square added all round by extrapolation), as JPEG."""
    H, _ = cv2.findHomography(BOARD.grid()[:, :2].astype(np.float32), corners.astype(np.float32))
    image = np.full((480, 640), 95, dtype=np.uint8)
    cv2.rectangle(image, (0, 330), (640, 480), 70, -1)
    for row in range(-2, BOARD.rows + 1):
        for column in range(-2, BOARD.columns + 1):
            inside = -1 <= row < BOARD.rows and -1 <= column < BOARD.columns
            square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
            square += [column, row]
            p = cv2.perspectiveTransform(square[None], H)[0]
            tone = 45 if inside and (row + column) % 2 == 0 else 205
            cv2.fillConvexPoly(image, np.round(p * 16).astype(np.int32), tone, cv2.LINE_AA, 4)
    image = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    return bytes(cv2.imencode(".jpg", image)[1])


def make_snapshots(extraction: Extraction) -> tuple[Snapshot, ...]:
    rng = np.random.default_rng(5)
    return tuple(
        Snapshot(o.log, o.station, _picture(o.left.pixels, rng), _picture(o.right.pixels, rng))
        for o in extraction.observations
    )


HOSTILE = "</title><script>alert(1)</script>\"'&\x00\x1b[31m\u202e$x_{$ {{7*7}} \udcff"


def make_hostile(extraction: Extraction) -> Extraction:
    """The same, with every string that a log can set turned nasty."""
    rig = extraction.rig
    camera = replace(rig.cameras.left, frame_id=HOSTILE)
    rig = replace(
        rig,
        cameras=replace(rig.cameras, left=camera),
        chain=replace(
            rig.chain,
            base_frame=HOSTILE,
            head_frame=HOSTILE,
            links=tuple(
                replace(link, joint=HOSTILE + link.joint) if isinstance(link, JointLink) else link
                for link in rig.chain.links
            ),
            pan=HOSTILE + rig.chain.pan,
            tilt=HOSTILE + rig.chain.tilt,
        ),
        sources=replace(
            rig.sources,
            image={"left": HOSTILE, "right": HOSTILE},
            info={"left": HOSTILE, "right": ""},
            joints=(HOSTILE,),
        ),
        settled_by={HOSTILE: HOSTILE},
    )
    return replace(
        extraction,
        rig=rig,
        rejections=(Rejection(HOSTILE, HOSTILE, HOSTILE, -5, 3),),
        notes=(HOSTILE,),
        logs=(LogSource(HOSTILE, "0" * 64),),
        counts={HOSTILE: 3, "stations": 15},
    )
