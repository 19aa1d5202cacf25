"""Point error and reprojection error of each leg for given parameters."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.model import BoolArray, Extraction, FloatArray, Parameters, Residuals, Side
from mobilecal_cli.solvers.carry import base_motion, camera_motion
from mobilecal_cli.solvers.loops import Loops


def dead_reckoned(loops: Loops, parameters: Parameters) -> FloatArray:
    """Base pose T_w_v of every station by dead reckoning, (N, 4, 4); w is the base at the recording's first one."""
    T_w_v = np.broadcast_to(np.eye(4), loops.T_v_h.shape).copy()
    T_vi_vj = base_motion(integrate(loops.steps, parameters.wheels))
    for (i, j), T in zip(loops.legs, T_vi_vj, strict=True):
        T_w_v[j] = T_w_v[i] @ T
    return T_w_v


def residuals_of(
    extraction: Extraction, loops: Loops, parameters: Parameters, believed: BoolArray | None = None
) -> Residuals:
    """Residuals of each station's corners predicted from the next station (eq. 18), in m and px.

    Args:
        extraction, loops: the observations and the legs between them.
        parameters: for the prediction.
        believed: (L,) legs to include; all by default.
    """
    kept = np.arange(len(loops.legs)) if believed is None else np.flatnonzero(believed)
    i, j = loops.legs[kept].T
    cameras = extraction.rig.cameras
    carried_c = se3.act(camera_motion(loops, parameters)[kept], loops.points_c[j])
    carried_r = se3.act(se3.inverse(cameras.T_c_r), carried_c)
    predicted = {"left": project(cameras.left, carried_c), "right": project(cameras.right, carried_r)}
    seen = {
        "left": np.stack([o.left.pixels for o in extraction.observations])[i],
        "right": np.stack([o.right.pixels for o in extraction.observations])[i],
    }
    sides: tuple[Side, Side] = ("left", "right")
    squares = [np.sum((predicted[side] - seen[side]) ** 2, axis=-1) for side in sides]
    measured = np.stack([[getattr(o, side).seen for o in extraction.observations] for side in sides])[:, i]
    T_w_v = dead_reckoned(loops, parameters)
    return Residuals(
        legs=loops.legs[kept],
        leg_point_rms_m=np.sqrt(np.mean(np.sum((carried_c - loops.points_c[i]) ** 2, axis=-1), axis=-1)),
        predicted_left_px=predicted["left"],
        predicted_right_px=predicted["right"],
        leg_reprojection_px=np.sqrt(np.mean(np.stack(squares), axis=(0, 2), where=measured)),
        T_w_v=T_w_v,
        T_w_k=T_w_v @ loops.T_v_h @ parameters.T_h_c @ loops.T_c_k,
    )
