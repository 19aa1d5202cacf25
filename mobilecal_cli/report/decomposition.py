"""What the station-to-station corner error consists of, to first order: corners, joints, floor and wheels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import encoder_steps_rad, head_jacobian, head_pose
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.likelihood.legs import leg_covariances
from mobilecal_cli.model import Extraction, FloatArray, NoiseLevels, Solution


@dataclass(frozen=True, slots=True)
class ErrorPart:
    """The error that one kind of noise alone causes, root mean square over the legs.

    Attributes:
        px: in the images of the left camera.
        m: in space.
    """

    px: float
    m: float


def error_parts(solution: Solution, extraction: Extraction) -> Mapping[str, ErrorPart]:
    """Kind of noise ("corners", "joints", "floor", "wheels") → its error; empty without noise levels or legs."""
    found, legs = solution.uncertainty, solution.residuals.legs
    if found is None or not len(legs):
        return {}
    geometry = _Geometry.of(solution, extraction)
    i, j = legs.T
    own = geometry.own_squares(found.noise, extraction)
    parts = {name: own[name][:, i] + own[name][:, j] for name in ("joints", "floor")}
    parts["corners"] = geometry.corner_squares(found.noise, solution)
    parts["wheels"] = geometry.wheel_squares(_wheel_covariance(solution, extraction), solution)
    return {
        name: ErrorPart(*np.sqrt(np.mean(parts[name], axis=1)).tolist())
        for name in ("corners", "joints", "floor", "wheels")
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Geometry:
    """Board corners in the left camera at N stations.

    Attributes:
        points: (N, M, 3) m.
        by_point: (N, M, 2, 3) derivative of their pixels, px/m.
        T_v_c: (N, 4, 4) camera in the base.
        points_cov: (N, M, 3, 3) of the triangulated corners.
        by_joints: (N, 6, J) twists of the camera by the joints.
    """

    points: FloatArray
    by_point: FloatArray
    T_v_c: FloatArray
    points_cov: FloatArray
    by_joints: FloatArray

    @classmethod
    def of(cls, solution: Solution, extraction: Extraction) -> _Geometry:
        seen, chain, X = extraction.observations, extraction.rig.chain, solution.parameters.T_h_c
        joints = np.stack([o.joints for o in seen])
        grid = extraction.board.grid()
        points = np.stack([se3.act(o.T_c_k, grid * o.square_m) for o in seen])
        _, by_point = project_with_jacobian(solution.cameras.left, points)
        by_joints = se3.adjoint(se3.inverse(X)) @ head_jacobian(chain, joints)
        cov = np.stack([o.points_cov for o in seen])
        return cls(points, by_point, head_pose(chain, joints) @ X, cov, by_joints)

    def _squares(self, motion: FloatArray, at: FloatArray | slice = slice(None)) -> FloatArray:
        """(2, n) mean squares, px^2 and m^2, of motions of the points, (n, M, 3, k), each with its sigma."""
        px = self.by_point[at] @ motion
        return np.stack([np.sum(each**2, axis=(2, 3)).mean(axis=1) for each in (px, motion)])

    def own_squares(self, noise: NoiseLevels, extraction: Extraction) -> Mapping[str, FloatArray]:
        """Mean squares, (2, N), due to the noise at each station: of "joints" and of "floor"."""
        base = np.zeros((6, 3))
        base[0, 0] = base[1, 1] = math.hypot(noise.floor_rad, noise.sway_rad)
        base[5, 2] = math.hypot(noise.floor_m, noise.sway_m)
        twists = {
            "joints": self.by_joints * (noise.joint_rad * np.array(extraction.rig.chain.joint_units)),
            "floor": se3.adjoint(se3.inverse(self.T_v_c)) @ base,
        }
        by_twist = np.concatenate(
            [-se3.skew(self.points), np.broadcast_to(np.eye(3), (*self.points.shape, 3))], axis=-1
        )
        return {name: self._squares(by_twist @ twist[:, None]) for name, twist in twists.items()}

    def corner_squares(self, noise: NoiseLevels, solution: Solution) -> FloatArray:
        """(2, L) due to the corners: detected at one station, triangulated at the other."""
        i, j = solution.residuals.legs.T
        T_w_c = solution.residuals.T_w_v @ self.T_v_c
        R = (se3.inverse(T_w_c[i]) @ T_w_c[j])[:, None, :3, :3]
        carried = R @ self.points_cov[j] @ np.swapaxes(R, -1, -2)
        J = self.by_point[i]
        px = (
            np.trace(J @ carried @ np.swapaxes(J, -1, -2), axis1=-2, axis2=-1).mean(axis=1)
            + 2 * noise.pixel_px**2
        )
        m = np.trace(self.points_cov[i] + carried, axis1=-2, axis2=-1).mean(axis=1)
        return np.stack([px, m])

    def wheel_squares(self, covariance: FloatArray, solution: Solution) -> FloatArray:
        """(2, L) due to odometry, with the covariance (L, 3, 3) of x, y and heading on each leg."""
        i, j = solution.residuals.legs.T
        T = self.T_v_c[i]
        T_w_v = solution.residuals.T_w_v
        end = (se3.inverse(T_w_v[i]) @ T_w_v[j])[:, None, :2, 3]
        lever = se3.act(T, self.points[i])[..., :2] - end
        by_pose = np.zeros((*lever.shape[:2], 3, 3))
        by_pose[..., 0, 0] = by_pose[..., 1, 1] = 1.0
        by_pose[..., 0, 2], by_pose[..., 1, 2] = -lever[..., 1], lever[..., 0]
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        motion = np.swapaxes(T[:, None, :3, :3], -1, -2) @ by_pose @ root[:, None]
        return self._squares(motion, i)


def _wheel_covariance(solution: Solution, extraction: Extraction) -> FloatArray:
    """(L, 3, 3) covariance of odometry's (x, y, heading) on each leg of the residuals."""
    assert solution.uncertainty is not None
    data, wheels = dataset_of(extraction), solution.parameters.wheels
    noise = solution.uncertainty.noise
    every = sum(leg_covariances(data.steps(), wheels, noise).values())
    number = {(a, b): k for k, (a, b) in enumerate(data.legs.tolist())}
    covariance = np.asarray(every)[[number[a, b] for a, b in solution.residuals.legs.tolist()]]
    if noise.encoder_rad:
        steps = encoder_steps_rad(extraction.wheels)
        path_m = noise.encoder_rad * steps / max(steps.max(), 1e-12) * wheels.vector[:2]
        square = 2 * float(np.sum(path_m**2))  # a reading at both ends
        covariance = covariance + np.diag([square / 4, 0.0, square / wheels.separation_m**2])
    return covariance
