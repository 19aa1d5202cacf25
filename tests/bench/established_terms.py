"""The likelihood term by term, for solvers that take it so: the same for each of them.

All unknowns are plain vectors, counted from the start where they turn: X = exp(rotation) R_X0, T_w_k = T_w_k0 (exp, t).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian, head_pose, integrate
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.legs import all_covariances
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import WheelGeometry
from tests.bench.simulated import TRUE_NOISE

_Z = np.array([0.0, 0.0, 1.0])


_Result = TypeVar("_Result")


def _timed(term: Callable[..., _Result]) -> Callable[..., _Result]:
    """The time that a term takes is added up: solvers that are not written in Python wait for it."""

    @wraps(term)
    def timed(self: Terms, *given: Any) -> _Result:
        began = time.perf_counter()
        result = term(self, *given)
        self.seconds += time.perf_counter() - began
        return result

    return timed


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Where the unknowns stand.

    Attributes:
        head_eye: (6,) rotation vector from the start's, translation, rad and m.
        board: (6,) twist from the start's board: rotation vector, translation in its frame.
        wheels: (3,) rR, rL, b, m.
        bases: (3,) x, y, heading of each station; the first one's is known.
        errors: (J,) of each station's joints.
    """

    head_eye: FloatArray
    board: FloatArray
    wheels: FloatArray
    bases: list[FloatArray]
    errors: list[FloatArray]


class Terms:
    """Whitened residuals of single stations and legs, with their derivatives.

    Attributes:
        seconds: What all calls so far have taken.
    """

    def __init__(self, data: Dataset, start: State) -> None:
        self.seconds = 0.0
        self.data, self.start = data, start
        self.R_X0, self.board0 = start.parameters.T_h_c[:3, :3], start.T_w_k[0]
        self.joints = data.joints.shape[1]
        shares = all_covariances(start, TRUE_NOISE)
        covariance = np.asarray(sum(shares.values()))
        roots = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2)
        steps = data.steps()
        ends = np.searchsorted(steps.leg, np.arange(steps.legs + 1))
        self._legs = []
        for leg, root in enumerate(roots):
            own = slice(ends[leg], ends[leg + 1])
            right, left = steps.right_rad[own], steps.left_rad[own]
            first = np.zeros(len(right), dtype=np.int64)
            self._legs.append((replace(steps, right_rad=right, left_rad=left, leg=first, legs=1), root))
        self._T_r_c = se3.inverse(data.cameras.T_c_each[1])

    def first(self) -> Unknowns:
        """The unknowns at the start."""
        wheels, start = self.start.parameters.wheels, self.start
        return Unknowns(
            np.concatenate([np.zeros(3), start.parameters.T_h_c[:3, 3]]),
            np.zeros(6),
            np.array([wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]),
            [row.copy() for row in start.base[:, :3]],
            [np.zeros(self.joints) for _ in start.base],
        )

    def state(self, at: Unknowns) -> State:
        """The state that some unknowns stand for."""
        T_h_c = se3.transform(se3.exp_so3(at.head_eye[:3]) @ self.R_X0, at.head_eye[3:])
        T_w_k = self.board0 @ se3.transform(se3.exp_so3(at.board[:3]), at.board[3:])
        wheels = WheelGeometry(*(float(size) for size in at.wheels))
        return replace(
            self.start,
            parameters=replace(self.start.parameters, T_h_c=T_h_c, wheels=wheels),
            T_w_k=T_w_k[None],
            base=np.column_stack([at.bases, self.start.base[:, 3:]]),
            own=np.column_stack([at.errors, self.start.own[:, self.joints :]]),
        )

    @_timed
    def views(
        self,
        derivatives: bool,
        station: int,
        head_eye: FloatArray,
        board: FloatArray,
        base: FloatArray,
        error: FloatArray,
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """(4 M,) of a station's two pictures; on request, derivatives by head-eye, board, base and joint errors."""
        data = self.data
        rig, joints = data.cameras, data.joints[station] + error
        R_X = se3.exp_so3(head_eye[:3]) @ self.R_X0
        turned = data.points_k @ se3.exp_so3(board[:3]).T
        p_w = (turned + board[3:]) @ self.board0[:3, :3].T + self.board0[:3, 3]
        Rz = se3.rotation_z(base[2])
        p_v = (p_w - [base[0], base[1], 0.0]) @ Rz
        H = head_pose(data.chain, joints)
        p_h = (p_v - H[:3, 3]) @ H[:3, :3]
        p_c = (p_h - head_eye[3:]) @ R_X
        at_left, J_left = project_with_jacobian(rig.each[0], p_c)
        at_right, J_right = project_with_jacobian(rig.each[1], se3.act(self._T_r_c, p_c))
        W, seen = data.whitening[station] / TRUE_NOISE.pixel_px, data.pixels[station]
        off = np.stack([at_left - seen[0], at_right - seen[1]])
        residual = (W @ off[..., None]).ravel()
        if not derivatives:
            return residual, ()
        J_c = W @ np.stack([J_left, J_right @ self._T_r_c[:3, :3]])  # (2, M, 2, 3)
        J_h = J_c @ R_X.T
        J_v = J_h @ H[:3, :3].T
        J_w = J_v @ Rz.T
        J_b = J_w @ self.board0[:3, :3]
        by_X = np.cross(J_h, (p_h - head_eye[3:])[:, None, :]) @ se3.left_jacobian_so3(head_eye[:3])
        by_board = np.cross(turned[:, None, :], J_b) @ se3.left_jacobian_so3(board[:3])
        by_heading = -J_v @ np.cross(_Z, p_v)[:, :, None]
        J_q = head_jacobian(data.chain, joints)
        shift = np.cross(J_q[:3].T[None], p_h[:, None, :]) + J_q[3:].T  # (M, J, 3)
        blocks = (
            np.concatenate([by_X, -J_h], axis=-1),
            np.concatenate([by_board, J_b], axis=-1),
            np.concatenate([-J_w[..., :2], by_heading], axis=-1),
            -J_h @ np.swapaxes(shift, 1, 2),
        )
        return residual, tuple(block.reshape(len(residual), -1) for block in blocks)

    @_timed
    def leg(
        self, derivatives: bool, leg: int, first: FloatArray, second: FloatArray, sizes: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """(3,) of a leg's odometry; on request, derivatives by its first base, its second and the wheels."""
        steps, root = self._legs[leg]
        cos, sin = np.cos(first[2]), np.sin(first[2])
        dx, dy = second[:2] - first[:2]
        x, y = cos * dx + sin * dy, -sin * dx + cos * dy
        arcs = integrate(steps, WheelGeometry(*(float(size) for size in sizes)))
        off = [arcs.t_m[0, 0] - x, arcs.t_m[0, 1] - y, arcs.psi_rad[0] - (second[2] - first[2])]
        if not derivatives:
            return root @ off, ()
        by_second = np.array([[-cos, -sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]])
        by_first = -by_second
        by_first[:2, 2] = [-y, x]
        return root @ off, (root @ by_first, root @ by_second, root @ arcs.by_wheels()[0])

    @_timed
    def reading(
        self, derivatives: bool, station: int, error: FloatArray
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """(J,) of a station's joint readings; on request, the derivative by the joint errors."""
        whitened = error / TRUE_NOISE.joint_rad
        return whitened, (np.eye(self.joints) / TRUE_NOISE.joint_rad,) if derivatives else ()
