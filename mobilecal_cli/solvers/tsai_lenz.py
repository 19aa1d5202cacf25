"""Head-eye rotation from pairs of rotations (paper, eqs. 5-7; Tsai and Lenz 1989)."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FloatArray

_NEAR_HALF_TURN = 0.05  # cos(theta/2) below this: the sign of the axis is ambiguous


def head_eye_rotation(R_hi_hj: FloatArray, R_ci_cj: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least-squares solution of R_hi_hj R_X = R_X R_ci_cj.

    With ``P = 2 sin(theta/2) n`` eq. 5 reads ``skew(P_H + P_C) P' = P_C - P_H``, where ``P' = v/w`` for the
    unit quaternion (v, w) of R_X. Multiplied by w it is homogeneous in (v, w). The singular vector of the smallest
    singular value is the solution, also for a head-eye rotation by a half turn (w = 0), where eq. 5 is undefined.

    Args:
        R_hi_hj: (P, 3, 3) rotations of the head.
        R_ci_cj: (P, 3, 3) rotations of the camera over the same pairs.

    Returns:
        R_X = R_h_c (3, 3) and the (4,) singular values in decreasing order, divided by the square root of P. The last
        is the residual. The last but one is zero if all rotation axes are parallel, and the solution undetermined.
    """
    q_h, q_c = se3.quaternion_xyzw(R_hi_hj), se3.quaternion_xyzw(R_ci_cj)
    P_h, P_c = 2 * q_h[:, :3], 2 * q_c[:, :3]
    rows = np.concatenate([se3.skew(P_h + P_c), (P_h - P_c)[:, :, None]], axis=2)
    rows[(q_h[:, 3] < _NEAR_HALF_TURN) | (q_c[:, 3] < _NEAR_HALF_TURN)] = 0
    _, singular, Vt = np.linalg.svd(rows.reshape(-1, 4), full_matrices=False)
    return se3.from_quaternion_xyzw(Vt[-1]), singular / np.sqrt(len(rows))
