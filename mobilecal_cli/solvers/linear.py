"""The iterative linear method (paper, section 3): solve for rotation, wheel ratios and translation in turn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.model import FloatArray, IntArray, LinearEstimate, Parameters, WheelGeometry
from mobilecal_cli.solvers.carry import point_rms_m
from mobilecal_cli.solvers.loops import Loops
from mobilecal_cli.solvers.tsai_lenz import head_eye_rotation

PAPER_TOLERANCE = 1e-3  # section 3.5, step 6: no parameter moves by more than 0.1 %
FIXED_POINT = 1e-13
MAX_ROUNDS = 200
_TRANSLATION_SCALE_M = 0.1  # least scale, so that a translation near zero can converge
_PAIRS_PER_STATION = 40
_SCOUT_LEGS = 40
_SCOUT_ROUNDS = 40
_SAME_ANSWER = 1e-3
_CLEARLY_BETTER = 0.5
_UNAMBIGUOUS_RAD = math.radians(150)  # unwrapped correctly by any guess within a fifth of the true ratios
_NEAR_NOMINAL = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Initial wheel ratios (aR, aL) = (rR/b, -rL/b) (eq. 11), and their origin."""

    ratios: FloatArray
    origin: str


def ratios_of(wheels: WheelGeometry) -> FloatArray:
    """Wheel ratios (aR, aL) of eq. 11, (2,)."""
    return np.array([wheels.radius_right_m, -wheels.radius_left_m]) / wheels.separation_m


def grid_of_starts() -> list[Start]:
    """Initial wheel ratios over the common scale r/b, 0.02 to 2, and zero.

    The step is 15 %: the grid value closest to the truth unwraps legs of up to 360 degrees correctly.
    """
    scales = np.geomspace(0.02, 2.0, 34)
    return [Start(np.array([0.0, 0.0]), "grid"), *(Start(s * np.array([1.0, -1.0]), "grid") for s in scales)]


def _pairs(loops: Loops) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of stations (i, j) of one recording, and the (P, 2) range of legs between them.

    Pairs of distant stations are included: the head rotates more between them, so the axes are more accurate.
    """
    spans = []
    for start in np.unique(loops.chain):
        legs = np.flatnonzero(loops.chain == start)
        stride = max(1, len(legs) // _PAIRS_PER_STATION)
        begin = np.arange(len(legs))[:, None]
        end = begin + np.arange(0, len(legs), stride)
        begin, end = np.broadcast_to(begin, end.shape)[end < len(legs)], end[end < len(legs)]
        spans.append(np.stack([legs[begin], legs[end] + 1], axis=1))
    span = np.concatenate(spans)
    return loops.legs[span[:, 0], 0], loops.legs[span[:, 1] - 1, 1], span


class _Rounds:
    """Iterations on fixed loops, with the constant matrices computed once."""

    def __init__(self, loops: Loops) -> None:
        self._loops = loops
        self._i, self._j = loops.legs.T
        self._Phi = loops.steps.totals_rad
        self._T_ci_cj = loops.T_c_k[self._i] @ se3.inverse(loops.T_c_k[self._j])
        self._first, self._last, self._span = _pairs(loops)
        R_c_k = loops.T_c_k[:, :3, :3]
        self._R_pairs_c = R_c_k[self._first] @ np.swapaxes(R_c_k[self._last], 1, 2)
        self._R_v_h = loops.T_v_h[:, :3, :3]

    def rotation(self, psi_rad: FloatArray) -> FloatArray:
        """Step 2: R_X from the head's rotations, R_hi_hj = R_v_hi^T Rz(psi_ij) R_v_hj (eq. 8)."""
        heading = np.concatenate([[0.0], np.cumsum(psi_rad)])
        Rz = se3.rotation_z(heading[self._span[:, 1]] - heading[self._span[:, 0]])
        R_hi_hj = np.swapaxes(self._R_v_h[self._first], 1, 2) @ Rz @ self._R_v_h[self._last]
        return head_eye_rotation(R_hi_hj, self._R_pairs_c)[0]

    def ratios(self, R_h_c: FloatArray, psi_rad: FloatArray) -> FloatArray:
        """Step 3: (aR, aL) from the turns measured by the camera (eqs. 12-13), unwrapped with odometry."""
        R = (
            self._R_v_h[self._i]
            @ R_h_c
            @ self._T_ci_cj[:, :3, :3]
            @ R_h_c.T
            @ np.swapaxes(self._R_v_h[self._j], 1, 2)
        )
        seen = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
        turns = np.round((psi_rad - seen) / (2 * math.pi))
        solved: FloatArray = np.linalg.lstsq(self._Phi, seen + 2 * math.pi * turns)[0]
        return solved

    def translation(self, R_h_c: FloatArray, ratios: FloatArray) -> Parameters:
        """Step 4: t_X and rL from the closed loop's translation (eqs. 14-17, with the z row)."""
        a_right, a_left = ratios
        per_left_radius = WheelGeometry(-a_right / a_left, 1.0, -1 / a_left)
        motion = integrate(self._loops.steps, per_left_radius)
        beta = np.concatenate([motion.t_m, np.zeros((len(motion.t_m), 1))], axis=1)
        Rz = se3.rotation_z(motion.psi_rad)
        T_v_hi, T_v_hj = self._loops.T_v_h[self._i], self._loops.T_v_h[self._j]
        B = T_v_hi[:, :3, :3] - Rz @ T_v_hj[:, :3, :3]
        seen = T_v_hi[:, :3, :3] @ R_h_c @ self._T_ci_cj[:, :3, 3:]
        right_side = -(seen + T_v_hi[:, :3, 3:] - Rz @ T_v_hj[:, :3, 3:])[..., 0]
        rows = np.concatenate([B, -beta[:, :, None]], axis=2).reshape(-1, 4)
        t_x, t_y, t_z, r_left = np.linalg.lstsq(rows, right_side.reshape(-1))[0]
        wheels = WheelGeometry(float(-a_right / a_left * r_left), float(r_left), float(-r_left / a_left))
        return Parameters(se3.transform(R_h_c, np.array([t_x, t_y, t_z])), wheels)

    def turns(self, ratios: FloatArray) -> FloatArray:
        """Psi of each leg (eq. 10), rad."""
        return self._Phi @ ratios

    def run(self, ratios: FloatArray) -> Iterator[Parameters]:
        """The parameters after each iteration; endless."""
        while True:
            psi = self.turns(ratios)
            R_h_c = self.rotation(psi)
            ratios = self.ratios(R_h_c, psi)
            if not np.all(np.isfinite(ratios)) or np.min(np.abs(ratios)) < 1e-9:
                return
            yield self.translation(R_h_c, ratios)


def linear_from(loops: Loops, wheels: WheelGeometry, rounds: int = 3) -> Parameters:
    """The iterative linear solution of a few legs from approximate wheels.

    Raises:
        SolveError: the iteration fails.
    """
    history = list(itertools.islice(_Rounds(loops).run(ratios_of(wheels)), rounds))
    if len(history) < rounds:
        raise SolveError(
            f"the iterative linear method failed on {len(loops.legs)} legs",
            "check the nominal wheels; record a motion in which the base drives and turns and the head pans and tilts",
        )
    return history[-1]


def _wheel_vector(wheels: WheelGeometry) -> FloatArray:
    return np.array([wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m])


def change(before: Parameters, after: Parameters) -> float:
    """Largest relative change of rotation, translation and wheels."""
    turned = np.linalg.norm(se3.log_so3(before.T_h_c[:3, :3].T @ after.T_h_c[:3, :3]))
    moved = np.linalg.norm(after.T_h_c[:3, 3] - before.T_h_c[:3, 3])
    scale = max(float(np.linalg.norm(after.T_h_c[:3, 3])), _TRANSLATION_SCALE_M)
    old, new = _wheel_vector(before.wheels), _wheel_vector(after.wheels)
    return float(max(turned, moved / scale, np.max(np.abs(new - old) / np.abs(new))))


def _iterate(rounds: _Rounds, ratios: FloatArray, tolerance: float, limit: int) -> list[Parameters]:
    history: list[Parameters] = []
    for parameters in rounds.run(ratios):
        history.append(parameters)
        if len(history) >= limit or (len(history) > 1 and change(history[-2], parameters) < tolerance):
            break
    return history


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    history: list[Parameters]
    start: Start
    point_rms_m: float

    @property
    def parameters(self) -> Parameters:
        return self.history[-1]

    @property
    def positive(self) -> bool:
        return bool(np.all(_wheel_vector(self.parameters.wheels) > 0))


def _scouted(loops: Loops, starts: list[Start]) -> list[Start]:
    """Solutions from all starts on the legs that turn least, whose unwrapping is the safest; best first."""
    Phi = loops.steps.totals_rad
    by_turn = np.argsort(np.abs(Phi[:, 0] - Phi[:, 1]), kind="stable")
    least = np.sort(by_turn[: max(4, min(_SCOUT_LEGS, len(Phi) // 2))])
    scout, whole = _Rounds(loops.select(least)), _Rounds(loops)
    found: list[tuple[float, Start]] = []
    for start in starts:
        for rounds in (scout, whole):
            history = _iterate(rounds, start.ratios, PAPER_TOLERANCE, _SCOUT_ROUNDS)
            if not history:
                continue
            ratios = ratios_of(history[-1].wheels)
            if any(np.allclose(ratios, other.ratios, rtol=0.02, atol=0) for _, other in found):
                continue
            # Rate the guess by the point error on all legs, after up to two more iterations on them.
            onward = _iterate(whole, ratios, PAPER_TOLERANCE, 2)
            if onward:
                found.append((point_rms_m(loops, onward[-1]), Start(ratios, start.origin)))
    return [start for _, start in sorted(found, key=lambda item: item[0])]


def _answers(loops: Loops, starts: list[Start]) -> list[_Answer]:
    rounds = _Rounds(loops)
    answers: list[_Answer] = []
    for start in starts:
        history = _iterate(rounds, start.ratios, FIXED_POINT, MAX_ROUNDS)
        if history:
            answers.append(_Answer(history, start, point_rms_m(loops, history[-1])))
    return answers


def _beyond_doubt(loops: Loops, nominal: WheelGeometry, answer: _Answer) -> bool:
    """Whether an answer is near the nominal wheels, and all legs turn little enough for unique unwrapping."""
    turns = np.abs(loops.steps.totals_rad @ ratios_of(nominal))
    apart = _wheel_vector(answer.parameters.wheels) / _wheel_vector(nominal) - 1
    return bool(turns.max(initial=0.0) < _UNAMBIGUOUS_RAD and np.abs(apart).max() < _NEAR_NOMINAL)


def linear_estimate(
    loops: Loops, nominal: WheelGeometry | None = None, given: FloatArray | None = None
) -> LinearEstimate:
    """Iterative linear solution from several starts.

    The cameras measure a leg's turn only modulo 360 degrees, so a bad guess of the wheels unwraps large turns wrongly
    and the iteration converges to a wrong solution. Every start is therefore tried, first on the legs that turn least.
    The solution with the smallest point error is returned; positive wheels are preferred to mirror images. If the
    nominal wheels unwrap every turn uniquely, and the solution is near them, they are the only start.

    Args:
        loops: at least three legs.
        nominal: nominal wheels, tried first.
        given: (2,) wheel ratios (aR, aL) to start from, tried before the nominal ones.

    Raises:
        SolveError: no start gives a solution.
    """
    starts = []
    if given is not None:
        starts.append(Start(given, "given"))
    if nominal is not None:
        starts.append(Start(ratios_of(nominal), "nominal"))
    answers = _answers(loops, starts)
    if nominal is None or not any(_beyond_doubt(loops, nominal, answer) for answer in answers):
        answers += _answers(loops, _scouted(loops, starts + grid_of_starts())[:4])
    if not answers:
        raise SolveError(
            f"the iterative linear method found no solution for {len(loops.legs)} legs between stations",
            "record a motion in which the base drives and turns and the head pans and tilts",
        )
    # min() returns the first of equal solutions: given and nominal starts precede the grid.
    best = min(answers, key=lambda a: round(a.point_rms_m, 9))
    positive = min((a for a in answers if a.positive), key=lambda a: round(a.point_rms_m, 9), default=best)
    kept = best if best.point_rms_m < _CLEARLY_BETTER * positive.point_rms_m else positive
    rivals = [a.point_rms_m for a in answers if change(kept.parameters, a.parameters) > _SAME_ANSWER]
    steps = [math.inf, *(change(a, b) for a, b in zip(kept.history, kept.history[1:], strict=False))]
    settled = next((i for i, step in enumerate(steps, 1) if step < PAPER_TOLERANCE), len(steps))
    return LinearEstimate(
        parameters=kept.parameters,
        history=tuple(kept.history),
        rounds_to_tolerance=settled,
        point_rms_m=kept.point_rms_m,
        start_ratios=kept.start.ratios,
        start_from=kept.start.origin,
        rival_point_rms_m=min(rivals, default=math.inf),
    )
