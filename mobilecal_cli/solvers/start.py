"""Initial estimate: the linear solution, also for motions with unobservable parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.model import FloatArray, Parameters, WheelGeometry
from mobilecal_cli.solvers.carry import base_motion, point_rms_m
from mobilecal_cli.solvers.linear import ratios_of
from mobilecal_cli.solvers.loops import Loops
from mobilecal_cli.solvers.tsai_lenz import head_eye_rotation

TILTED_RAD = math.radians(2.0)  # a smaller range leaves Tsai-Lenz with parallel axes, whatever the noise
TURNED_RAD = 0.1  # wheel rotation: about 2.5 degrees of heading with typical wheels
DRIVEN_RAD = 0.1  # wheel rotation: about 2 cm with typical wheels
_UNLIKE = 0.05  # mean wheel rotation over the difference, in a turn in place with radii that differ by 10 %
_ROUNDS = 12
_HEADINGS = 720
# Accuracy of a leg's measured turn and path, against that of nominal values: weights of the priors.
_SEEN_RAD, _SEEN_M = 0.003, 0.003
_DRAWN = 0.2
_DRAWN_M = 0.1
_BLOCK = 500  # stations compared with all others at a time, to limit memory


@dataclass(frozen=True, slots=True)
class MotionSeen:
    """Amount of each kind of motion in the legs.

    Attributes:
        tilted_rad: largest angle between the vertical directions in the head's frame.
        turned_rad: largest difference of the two wheels' rotations over a leg.
        driven_rad: largest mean rotation of the two wheels over a leg.
    """

    tilted_rad: float
    turned_rad: float
    driven_rad: float

    @property
    def tilts(self) -> bool:
        """Whether the head's tilt changes."""
        return self.tilted_rad >= TILTED_RAD

    @property
    def turns(self) -> bool:
        """Whether the base turns."""
        return self.turned_rad >= TURNED_RAD

    @property
    def drives(self) -> bool:
        """Whether the base drives."""
        return self.driven_rad >= DRIVEN_RAD


def motion_seen(loops: Loops) -> MotionSeen:
    """Amount of motion in the joints and the wheels."""
    vertical_h = loops.T_v_h[:, 2, :3]
    blocks = (vertical_h[i : i + _BLOCK] for i in range(0, len(vertical_h), _BLOCK))
    least_cosine = min(float((block @ vertical_h.T).min()) for block in blocks)
    tilted = float(np.arccos(np.clip(least_cosine, -1, 1)))
    right, left = loops.steps.totals_rad.T
    return MotionSeen(
        tilted,
        float(np.abs(right - left).max(initial=0)),
        float(np.abs(right + left).max(initial=0)) / 2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Nominal values and whether the head-eye transform is fixed.

    Attributes:
        T_h_c: (4, 4) nominal head-eye transform of the left camera, or None.
        wheels: nominal wheels, or None.
        head_eye_fixed: T_h_c is fixed.
    """

    T_h_c: FloatArray | None
    wheels: WheelGeometry | None
    head_eye_fixed: bool = False


def _relative(loops: Loops) -> FloatArray:
    i, j = loops.legs.T
    T: FloatArray = loops.T_c_k[i] @ se3.inverse(loops.T_c_k[j])
    return T


def _aligned(loops: Loops, vertical_h: FloatArray, downwards: bool) -> FloatArray:
    """Rotation R_h_c that aligns the common axis of the camera's turns with the vertical; the yaw is arbitrary."""
    axes = se3.log_so3(_relative(loops)[:, :3, :3])
    n_c = np.linalg.svd(axes, full_matrices=False)[2][0] * (-1 if downwards else 1)
    v, cosine = np.cross(n_c, vertical_h), float(n_c @ vertical_h)
    if cosine < -1 + 1e-9:
        other = np.cross(n_c, np.eye(3)[np.argmin(np.abs(n_c))])
        return se3.rotation_about(other / np.linalg.norm(other), np.array(math.pi))
    R: FloatArray = np.eye(3) + se3.skew(v) + se3.skew(v) @ se3.skew(v) / (1 + cosine)
    return R


def _turns(loops: Loops, R_h_c: FloatArray, expected_rad: FloatArray) -> FloatArray:
    """Turn of each leg measured by the camera (eq. 12), unwrapped with the expected turn, (L,), rad."""
    i, j = loops.legs.T
    R_v_h = loops.T_v_h[:, :3, :3]
    R = R_v_h[i] @ R_h_c @ _relative(loops)[:, :3, :3] @ R_h_c.T @ np.swapaxes(R_v_h[j], 1, 2)
    seen = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
    unwrapped: FloatArray = seen + 2 * math.pi * np.round((expected_rad - seen) / (2 * math.pi))
    return unwrapped


def _pulled(rows: FloatArray, right: FloatArray, towards: FloatArray, weight: FloatArray) -> FloatArray:
    """Least squares with a prior on each unknown; undetermined unknowns stay at the prior value."""
    both = np.concatenate([rows, np.diag(weight)])
    solved: FloatArray = np.linalg.lstsq(both, np.concatenate([right, weight * towards]))[0]
    return solved


def _ratios(Phi: FloatArray, psi: FloatArray, nominal: FloatArray | None) -> FloatArray:
    if nominal is None:
        return np.asarray(np.linalg.lstsq(Phi, psi)[0])
    return _pulled(Phi, psi, nominal, _SEEN_RAD / (_DRAWN * np.abs(nominal)))


def _translation(
    loops: Loops, R_h_c: FloatArray, ratios: FloatArray, known: Known, headings: FloatArray | None
) -> Parameters:
    """Eqs. 14-17 with priors; `headings`: candidate yaws of the camera about the vertical if the yaw is unknown."""
    a_right, a_left = ratios
    per_left = WheelGeometry(-a_right / a_left, 1.0, -1 / a_left)
    motion = integrate(loops.steps, per_left)
    T_vi_vj = base_motion(motion)
    i, j = loops.legs.T
    T_i, T_j = loops.T_v_h[i], loops.T_v_h[j]
    Rz = T_vi_vj[:, :3, :3]
    B = T_i[:, :3, :3] - Rz @ T_j[:, :3, :3]
    fixed = T_i[:, :3, 3] - (Rz @ T_j[:, :3, 3:])[..., 0]
    rows = np.concatenate([B, -T_vi_vj[:, :3, 3:]], axis=2).reshape(-1, 4)
    towards, weight = np.zeros(4), np.full(4, _SEEN_M / _DRAWN_M)
    if known.T_h_c is not None:
        towards[:3] = known.T_h_c[:3, 3]
        weight[:3] *= 1e6 if known.head_eye_fixed else 1.0
    weight[3] = 0.0
    if known.wheels is not None:
        towards[3] = known.wheels.radius_left_m
        weight[3] = _SEEN_M / (_DRAWN * towards[3])
    seen = _relative(loops)[:, :3, 3]
    rotations = R_h_c[None]
    if headings is not None:
        vertical_h = loops.T_v_h[:, 2, :3].mean(axis=0)
        about = se3.rotation_about(vertical_h / np.linalg.norm(vertical_h), headings)
        rotations = about @ R_h_c
    # All yaws at once: they share the matrix, only the right-hand sides differ.
    right = -(np.einsum("lab,hbc,lc->hla", T_i[:, :3, :3], rotations, seen) + fixed).reshape(
        len(rotations), -1
    )
    both = np.concatenate([rows, np.diag(weight)])
    sides = np.concatenate([right, np.broadcast_to(weight * towards, (len(right), 4))], axis=1)
    solved, _, _, _ = np.linalg.lstsq(both, sides.T)
    misfit = np.sum((both @ solved - sides.T) ** 2, axis=0)
    misfit[solved[3] <= 0] = np.inf  # the mirror solution with negative wheels
    best = int(np.argmin(misfit))
    t_x, t_y, t_z, r_left = solved[:, best]
    wheels = WheelGeometry(float(-a_right / a_left * r_left), float(r_left), float(-r_left / a_left))
    return Parameters(se3.transform(rotations[best], np.array([t_x, t_y, t_z])), wheels)


def pulled_start(loops: Loops, known: Known, seen: MotionSeen) -> Parameters:
    """Linear solution with weak priors at the nominal values, for motions with unobservable parameters.

    If the head never tilts, all rotation axes are parallel and Tsai-Lenz is singular: roll and pitch then follow from
    the common axis, and yaw from the driving direction (as for a fixed camera, Antonelli et al. 2010). If the base
    never moves, the head-eye transform follows from the head's motion alone (Tsai and Lenz 1989).

    Raises:
        SolveError: unobservable wheels without nominal values, or no solution.
    """
    if known.wheels is None and not (seen.turns and seen.drives):
        raise SolveError(
            "wheel radii or separation are unobservable from this motion and have no nominal values",
            "drive and turn the base between stations, or set nominal.wheels in rig.yaml",
        )
    nominal = ratios_of(known.wheels) if known.wheels is not None else None
    Phi = loops.steps.totals_rad
    starts: list[tuple[FloatArray | None, bool]] = [(None, False)]
    if not seen.tilts and not known.head_eye_fixed:
        vertical_h = loops.T_v_h[:, 2, :3].mean(axis=0)
        vertical_h = vertical_h / np.linalg.norm(vertical_h)
        starts = [(_aligned(loops, vertical_h, down), True) for down in (False, True)]
    found: list[tuple[float, Parameters]] = []
    for aligned, yaw_unknown in starts:
        psi = Phi @ nominal if nominal is not None else np.zeros(len(Phi))
        headings = np.linspace(0, 2 * math.pi, _HEADINGS, endpoint=False) if yaw_unknown else None
        for _ in range(_ROUNDS):
            if known.head_eye_fixed and known.T_h_c is not None:
                R_h_c = known.T_h_c[:3, :3]
            elif aligned is not None:
                R_h_c = aligned
            else:
                R_h_c = _tsai_lenz(loops, psi)
            ratios = _ratios(Phi, _turns(loops, R_h_c, psi), nominal)
            if not np.all(np.isfinite(ratios)) or np.min(np.abs(ratios)) < 1e-9:
                break
            psi = Phi @ ratios
        else:
            parameters = _translation(loops, R_h_c, ratios, known, headings)
            found.append((point_rms_m(loops, parameters), parameters))
    if not found:
        raise SolveError(
            f"the linear method found no solution for {len(loops.legs)} legs between stations",
            "set nominal.wheels and nominal.head_eye in rig.yaml",
        )
    upright = [
        item for item in found if item[1].wheels.separation_m > 0
    ]  # an upside-down camera gives an equal solution with b < 0
    return min(upright or found, key=lambda item: item[0])[1]


def _tsai_lenz(loops: Loops, psi: FloatArray) -> FloatArray:
    i, j = loops.legs.T
    R_v_h = loops.T_v_h[:, :3, :3]
    R_hi_hj = np.swapaxes(R_v_h[i], 1, 2) @ se3.rotation_z(psi) @ R_v_h[j]
    return head_eye_rotation(R_hi_hj, _relative(loops)[:, :3, :3])[0]
