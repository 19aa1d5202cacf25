"""One iteration of the linear method (paper, section 3): rotation, wheel ratios, translation, and again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.constants import NINE_SIGMAS, WHEEL_SIGMA
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import Rig, WheelGeometry
from mobilecal_cli.solvers.transfer import base_motion

_PAIRS_PER_STATION = 40  # at most about twice as many: the pairs grow with the recording, not with its square
_HEADINGS = 720  # half a degree apart
# Accuracy of a leg's turn and length against that of nominal values: weights of the priors.
_LEG_RAD, _LEG_M = 0.003, 0.003
#: A radius or separation, and a ratio of them, that is zero but for rounding.
NO_SIZE_M, _NO_RATIO = 1e-12, 1e-9
_EXACT = 1e6  # weight of a fixed value over that of a nominal one
_SETTLED = 1e-6  # relative change of the ratios: an optimization or a comparison follows
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


@dataclass(frozen=True, slots=True, eq=False)
class NominalPrior:
    """Nominal values.

    Attributes:
        T_h_c: (4, 4) nominal pose of the first camera on the head, or None.
        wheels: nominal wheels, or None.
        head_eye_fixed: T_h_c is exact.
    """

    T_h_c: FloatArray | None = None
    wheels: WheelGeometry | None = None
    head_eye_fixed: bool = False


def nominal_of(rig: Rig, head_eye_fixed: bool = False) -> NominalPrior:
    """The nominal values of a robot."""
    T_h_reference, wheels = rig.nominal.T_h_reference, rig.nominal.wheels
    T_h_c = None if T_h_reference is None else T_h_reference @ se3.inverse(rig.cameras.T_c_reference)
    return NominalPrior(T_h_c, wheels, head_eye_fixed)


def ratios_of(wheels: WheelGeometry) -> FloatArray:
    """(aR, aL) of eq. 11."""
    return np.array([wheels.radius_right_m, -wheels.radius_left_m]) / wheels.separation_m


def _pairs(pairs: MotionPairs) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of stations (i, j) of one recording, and the (P, 2) range of legs that lie between them.

    More than consecutive pairs: far-apart stations turn the head more, so their axes are better known.
    """
    spans = []
    for start in np.unique(pairs.first_leg):
        legs = np.flatnonzero(pairs.first_leg == start)
        stride = max(1, len(legs) // _PAIRS_PER_STATION)
        begin = np.arange(len(legs))[:, None]
        end = begin + np.arange(0, len(legs), stride)
        begin, end = np.broadcast_to(begin, end.shape)[end < len(legs)], end[end < len(legs)]
        spans.append(np.stack([legs[begin], legs[end] + 1], axis=1))
    span = np.concatenate(spans)
    return pairs.legs[span[:, 0], 0], pairs.legs[span[:, 1] - 1, 1], span


def _least_squares(rows: FloatArray, right: FloatArray, mean: FloatArray, weight: FloatArray) -> FloatArray:
    """Solutions of least squares with a prior: rows (n, k), right sides (S, n), mean and weight (k,) → (S, k)."""
    both = np.concatenate([rows, np.diag(weight)])
    sides = np.concatenate([right, np.broadcast_to(weight * mean, (len(right), len(mean)))], axis=1)
    return np.asarray(np.linalg.lstsq(both, sides.T)[0].T)


class Rounds:
    """The steps of the method on some legs, one round after another.

    Args:
        pairs: the legs.
        prior: nominal values that pull weakly; None where the motion shows all parameters.
        common_axis: the head never tilts; +1 or -1 is the sign of the common axis, 0 for a head that tilts.
    """

    def __init__(self, pairs: MotionPairs, prior: NominalPrior | None = None, common_axis: int = 0) -> None:
        self._pairs = pairs
        self._prior = prior or NominalPrior()
        self._common_axis = common_axis
        self._i, self._j = pairs.legs.T
        self._Phi = pairs.steps.totals_rad
        self._T_ci_cj = pairs.T_c_k[self._i] @ se3.inverse(pairs.T_c_k[self._j])
        self._R_v_h = pairs.T_v_h[:, :3, :3]
        self._pulled = prior is not None

    @cached_property
    def _wide(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Pairs of stations further apart than a leg, and the camera's rotation over each."""
        first, last, span = _pairs(self._pairs)
        R_c_k = self._pairs.T_c_k[:, :3, :3]
        return first, last, span, R_c_k[first] @ R_c_k[last].mT

    @cached_property
    def _vertical_h(self) -> FloatArray:
        vertical = self._pairs.T_v_h[:, 2, :3].mean(axis=0)
        return np.asarray(vertical / np.linalg.norm(vertical))

    @cached_property
    def _aligned(self) -> FloatArray:
        """A rotation R_h_c that brings the axis of all the camera's turns onto the vertical; its yaw is arbitrary."""
        axes = se3.log_so3(self._T_ci_cj[:, :3, :3])
        n_c = np.linalg.svd(axes, full_matrices=False)[2][0] * self._common_axis
        return np.asarray(Rotation.align_vectors(self._vertical_h[None], n_c[None])[0].as_matrix())

    def rotation(self, psi_rad: FloatArray) -> FloatArray:
        """Step 2: R_X from the head's rotations, R_hi_hj = R_v_hi^T Rz(psi_ij) R_v_hj (eq. 8)."""
        if self._prior.head_eye_fixed and self._prior.T_h_c is not None:
            return np.asarray(self._prior.T_h_c[:3, :3])
        if self._common_axis:
            return self._aligned
        first, last, span, R_pairs_c = self._wide
        heading = np.concatenate([[0.0], np.cumsum(psi_rad)])
        Rz = se3.rotation_z(heading[span[:, 1]] - heading[span[:, 0]])
        R_hi_hj = self._R_v_h[first].mT @ Rz @ self._R_v_h[last]
        return head_eye_rotation(R_hi_hj, R_pairs_c)[0]

    def ratios(self, R_h_c: FloatArray, psi_rad: FloatArray) -> FloatArray:
        """Step 3: (aR, aL) from the turns that the camera saw (eqs. 12-13), unwrapped by odometry."""
        R_ci_cj, R_hj_v = self._T_ci_cj[:, :3, :3], self._R_v_h[self._j].mT
        R = self._R_v_h[self._i] @ R_h_c @ R_ci_cj @ R_h_c.T @ R_hj_v
        psi_seen = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
        turns = psi_seen + 2 * math.pi * np.round((psi_rad - psi_seen) / (2 * math.pi))
        mean, weight = np.zeros(2), np.zeros(2)
        if self._pulled and self._prior.wheels is not None:
            mean = ratios_of(self._prior.wheels)
            weight = _LEG_RAD / (WHEEL_SIGMA * np.abs(mean))
        return np.asarray(_least_squares(self._Phi, turns[None], mean, weight)[0])

    def translation(self, R_h_c: FloatArray, ratios: FloatArray) -> Parameters:
        """Step 4: t_X and rL from the closed loop's translation (eqs. 14-17, with the z row).

        Where the head never tilts, the yaw of the camera about the vertical is found here: the best of many.
        """
        a_right, a_left = ratios
        per_left_radius = WheelGeometry(-a_right / a_left, 1.0, -1 / a_left)
        T_vi_vj = base_motion(integrate(self._pairs.steps, per_left_radius))
        Rz, beta = T_vi_vj[:, :3, :3], T_vi_vj[:, :3, 3:]
        T_v_hi, T_v_hj = self._pairs.T_v_h[self._i], self._pairs.T_v_h[self._j]
        B = T_v_hi[:, :3, :3] - Rz @ T_v_hj[:, :3, :3]
        fixed = T_v_hi[:, :3, 3:] - Rz @ T_v_hj[:, :3, 3:]
        # The right sides are linear in the rotation. All legs together are a triangle of 14 rows.
        by_rotation = np.einsum("lab,lc->labc", T_v_hi[:, :3, :3], self._T_ci_cj[:, :3, 3])
        legs = np.concatenate([B, -beta, by_rotation.reshape(-1, 3, 9), fixed], axis=2).reshape(-1, 14)
        rows, by_rotation, fixed = np.split(np.linalg.qr(legs, mode="r"), [4, 13], axis=1)
        rotations = R_h_c[None]
        if self._common_axis:
            headings = np.linspace(0, 2 * math.pi, _HEADINGS, endpoint=False)
            rotations = se3.rotation_about(self._vertical_h, headings) @ R_h_c
        right = -(rotations.reshape(-1, 9) @ by_rotation.T + fixed.T)
        mean, weight = self._translation_prior()
        solved = _least_squares(rows, right, mean, weight)
        best = 0
        if len(rotations) > 1:
            misfit = np.sum((solved @ rows.T - right) ** 2, axis=1)
            misfit += np.sum((weight * (solved - mean)) ** 2, axis=1)
            misfit[solved[:, 3] <= 0] = np.inf  # the twin with all signs turned
            best = int(np.argmin(misfit))
        t_x, t_y, t_z, r_left = solved[best]
        wheels = WheelGeometry(float(-a_right / a_left * r_left), float(r_left), float(-r_left / a_left))
        return Parameters(se3.transform(rotations[best], np.array([t_x, t_y, t_z])), wheels)

    def _translation_prior(self) -> tuple[FloatArray, FloatArray]:
        """Mean and weight of (t_X, rL)."""
        mean, weight = np.zeros(4), np.zeros(4)
        if self._pulled:
            weight[:3] = _LEG_M / NINE_SIGMAS[3:6]
            if self._prior.T_h_c is not None:
                mean[:3] = self._prior.T_h_c[:3, 3]
                weight[:3] *= _EXACT if self._prior.head_eye_fixed else 1.0
            if self._prior.wheels is not None:
                mean[3] = self._prior.wheels.radius_left_m
                weight[3] = _LEG_M / (WHEEL_SIGMA * mean[3])
        return mean, weight

    def run(self, ratios: FloatArray) -> Iterator[Parameters]:
        """The parameters after each round, without end unless the iteration breaks down."""
        while True:
            psi = self._Phi @ ratios  # eq. 10
            R_h_c = self.rotation(psi)
            ratios = self.ratios(R_h_c, psi)
            if not np.all(np.isfinite(ratios)) or np.min(np.abs(ratios)) < _NO_RATIO:
                return
            parameters = self.translation(R_h_c, ratios)
            # Practically zero: the legs do not show that the base drives and turns.
            if np.abs(parameters.wheels.vector).min() < NO_SIZE_M:
                return
            yield parameters

    def after(self, ratios: FloatArray, most: int) -> Parameters:
        """The parameters after at most so many rounds; fewer where the wheels' ratios no longer change.

        Raises:
            SolveError: the iteration breaks down.
        """
        for count, parameters in enumerate(self.run(ratios), 1):
            before, ratios = ratios, ratios_of(parameters.wheels)
            if count == most or np.abs(ratios - before).max() < _SETTLED * np.abs(ratios).max():
                return parameters
        raise SolveError(
            f"the iterative linear method breaks down on these {len(self._pairs.legs)} legs",
            "record stations between which the base turns and drives and the head pans and tilts",
        )
