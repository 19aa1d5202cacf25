"""Initial parameters: the iterative linear method (paper, section 3): rotation, wheel ratios, translation, and again.

Where the motion does not show all parameters, weak priors from the nominal values keep the method regular. If the head
never tilts, all rotation axes are parallel and Tsai-Lenz is singular: roll and pitch then come from the common axis,
and yaw from the driving direction (as for a camera without a head, Antonelli et al. 2010). If the base never moves, the
head-eye transform comes from the head's motion alone (Tsai and Lenz 1989).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.dataset import MotionPairs
from mobilecal_cli.model import FloatArray, IntArray, LinearEstimate, Parameters, WheelGeometry
from mobilecal_cli.solvers.transfer import base_motion, point_rms_m
from mobilecal_cli.solvers.tsai_lenz import head_eye_rotation

PAPER_TOLERANCE = 1e-3  # section 3.5, step 6: no parameter moves by more than 0.1 %
FIXED_POINT = 1e-13
MAX_ROUNDS = 200
_TRANSLATION_SCALE_M = 0.1  # a component of t_X near zero must not keep the iteration from converging
_PAIRS_PER_STATION = 40
_SCOUT_LEGS = 40
_SCOUT_ROUNDS = 40
_SAME_ANSWER = 1e-3
_CLEARLY_BETTER = 0.5
_UNAMBIGUOUS_RAD = math.radians(150)  # a guess that is wrong by less than a fifth unwraps it correctly
_NEAR_NOMINAL = 0.15

TILTED_RAD = math.radians(2.0)  # a smaller range leaves Tsai-Lenz with parallel axes, whatever the noise
TURNED_RAD = 0.1  # wheel rotation: with usual wheels about 2.5 degrees of heading
DRIVEN_RAD = 0.1  # wheel rotation: with usual wheels about 2 cm
FEW_ROUNDS = 3  # from parameters that are nearly right
_PRIOR_ROUNDS = 12
_HEADINGS = 720
# Accuracy of a leg's turn and length against that of nominal values: weights of the priors.
_LEG_RAD, _LEG_M = 0.003, 0.003
_NOMINAL_SHARE, _NOMINAL_M = 0.2, 0.1
_EXACT = 1e6  # weight of a fixed value over that of a nominal one
_BLOCK = 500  # stations compared with all others at once


@dataclass(frozen=True, slots=True)
class MotionSeen:
    """Kinds of motion of the legs, and how much of each.

    Attributes:
        tilted_rad: largest angle between the base's verticals in the head's frame.
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


def motion_seen(pairs: MotionPairs) -> MotionSeen:
    """Motion of joints and wheels."""
    vertical_h = pairs.T_v_h[:, 2, :3]
    blocks = (vertical_h[i : i + _BLOCK] for i in range(0, len(vertical_h), _BLOCK))
    least_cosine = min(float((block @ vertical_h.T).min()) for block in blocks)
    tilted = float(np.arccos(np.clip(least_cosine, -1, 1)))
    right, left = pairs.steps.totals_rad.T
    return MotionSeen(
        tilted,
        float(np.abs(right - left).max(initial=0)),
        float(np.abs(right + left).max(initial=0)) / 2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class InitialPrior:
    """Nominal values.

    Attributes:
        T_h_c: (4, 4) nominal head-eye transform of the left camera, or None.
        wheels: nominal wheels, or None.
        head_eye_fixed: T_h_c is exact.
    """

    T_h_c: FloatArray | None = None
    wheels: WheelGeometry | None = None
    head_eye_fixed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Wheel ratios (aR, aL) = (rR/b, -rL/b) to start from (eq. 11), and their origin."""

    ratios: FloatArray
    origin: str


def ratios_of(wheels: WheelGeometry) -> FloatArray:
    """(aR, aL) of eq. 11."""
    return np.array([wheels.radius_right_m, -wheels.radius_left_m]) / wheels.separation_m


def grid_of_starts() -> list[Start]:
    """Starts over the common scale r/b, from tiny wheels far apart to huge ones close together.

    Neighbors are 15 % apart: the guess next to the truth unwraps legs of up to 360 degrees.
    """
    scales = np.geomspace(0.02, 2.0, 34)
    return [Start(np.array([0.0, 0.0]), "grid"), *(Start(s * np.array([1.0, -1.0]), "grid") for s in scales)]


def _pairs(pairs: MotionPairs) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of stations (i, j) of one recording, and the (P, 2) range of legs that lie between them.

    More than consecutive pairs: far-apart stations turn the head more, so their axes are better known.
    """
    spans = []
    for start in np.unique(pairs.chain):
        legs = np.flatnonzero(pairs.chain == start)
        stride = max(1, len(legs) // _PAIRS_PER_STATION)
        begin = np.arange(len(legs))[:, None]
        end = begin + np.arange(0, len(legs), stride)
        begin, end = np.broadcast_to(begin, end.shape)[end < len(legs)], end[end < len(legs)]
        spans.append(np.stack([legs[begin], legs[end] + 1], axis=1))
    span = np.concatenate(spans)
    return pairs.legs[span[:, 0], 0], pairs.legs[span[:, 1] - 1, 1], span


def _least_squares(rows: FloatArray, right: FloatArray, mean: FloatArray, weight: FloatArray) -> FloatArray:
    """Solutions of least squares with a prior: rows (n, k), right sides (S, n), mean and weight (k,) → (S, k)."""
    if not np.any(weight):
        return np.asarray(np.linalg.lstsq(rows, right.T)[0].T)
    both = np.concatenate([rows, np.diag(weight)])
    sides = np.concatenate([right, np.broadcast_to(weight * mean, (len(right), len(mean)))], axis=1)
    return np.asarray(np.linalg.lstsq(both, sides.T)[0].T)


class _Rounds:
    """The steps of the method on some legs, one round after another.

    Args:
        pairs: the legs.
        prior: nominal values that pull weakly; None where the motion shows all parameters.
        common_axis: the head never tilts; +1 or -1 is the sign of the common axis, 0 for a head that tilts.
    """

    def __init__(self, pairs: MotionPairs, prior: InitialPrior | None = None, common_axis: int = 0) -> None:
        self._pairs = pairs
        self._prior = prior or InitialPrior()
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
        return first, last, span, R_c_k[first] @ np.swapaxes(R_c_k[last], 1, 2)

    @cached_property
    def _vertical_h(self) -> FloatArray:
        vertical = self._pairs.T_v_h[:, 2, :3].mean(axis=0)
        return np.asarray(vertical / np.linalg.norm(vertical))

    @cached_property
    def _aligned(self) -> FloatArray:
        """A rotation R_h_c that brings the axis of all the camera's turns onto the vertical; its yaw is arbitrary."""
        axes = se3.log_so3(self._T_ci_cj[:, :3, :3])
        n_c = np.linalg.svd(axes, full_matrices=False)[2][0] * self._common_axis
        v, cosine = np.cross(n_c, self._vertical_h), float(n_c @ self._vertical_h)
        if cosine < -1 + 1e-9:
            other = np.cross(n_c, np.eye(3)[np.argmin(np.abs(n_c))])
            return se3.rotation_about(other / np.linalg.norm(other), np.array(math.pi))
        R: FloatArray = np.eye(3) + se3.skew(v) + se3.skew(v) @ se3.skew(v) / (1 + cosine)
        return R

    def rotation(self, psi_rad: FloatArray) -> FloatArray:
        """Step 2: R_X from the head's rotations, R_hi_hj = R_v_hi^T Rz(psi_ij) R_v_hj (eq. 8)."""
        if self._prior.head_eye_fixed and self._prior.T_h_c is not None:
            known: FloatArray = self._prior.T_h_c[:3, :3]
            return known
        if self._common_axis:
            return self._aligned
        first, last, span, R_pairs_c = self._wide
        heading = np.concatenate([[0.0], np.cumsum(psi_rad)])
        Rz = se3.rotation_z(heading[span[:, 1]] - heading[span[:, 0]])
        R_hi_hj = np.swapaxes(self._R_v_h[first], 1, 2) @ Rz @ self._R_v_h[last]
        return head_eye_rotation(R_hi_hj, R_pairs_c)[0]

    def ratios(self, R_h_c: FloatArray, psi_rad: FloatArray) -> FloatArray:
        """Step 3: (aR, aL) from the turns that the camera saw (eqs. 12-13), unwrapped by odometry."""
        R_ci_cj, R_hj_v = self._T_ci_cj[:, :3, :3], np.swapaxes(self._R_v_h[self._j], 1, 2)
        R = self._R_v_h[self._i] @ R_h_c @ R_ci_cj @ R_h_c.T @ R_hj_v
        seen = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
        turns = seen + 2 * math.pi * np.round((psi_rad - seen) / (2 * math.pi))
        mean, weight = np.zeros(2), np.zeros(2)
        if self._pulled and self._prior.wheels is not None:
            mean = ratios_of(self._prior.wheels)
            weight = _LEG_RAD / (_NOMINAL_SHARE * np.abs(mean))
        ratios: FloatArray = _least_squares(self._Phi, turns[None], mean, weight)[0]
        return ratios

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
        rows = np.concatenate([B, -beta], axis=2).reshape(-1, 4)
        fixed = T_v_hi[:, :3, 3] - (Rz @ T_v_hj[:, :3, 3:])[..., 0]
        rotations = R_h_c[None]
        if self._common_axis:
            headings = np.linspace(0, 2 * math.pi, _HEADINGS, endpoint=False)
            rotations = se3.rotation_about(self._vertical_h, headings) @ R_h_c
        # The matrix is the same for all yaws, only the right sides differ.
        seen = np.einsum("lab,hbc,lc->hla", T_v_hi[:, :3, :3], rotations, self._T_ci_cj[:, :3, 3])
        right = -(seen + fixed).reshape(len(rotations), -1)
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
            weight[:3] = _LEG_M / _NOMINAL_M
            if self._prior.T_h_c is not None:
                mean[:3] = self._prior.T_h_c[:3, 3]
                weight[:3] *= _EXACT if self._prior.head_eye_fixed else 1.0
            if self._prior.wheels is not None:
                mean[3] = self._prior.wheels.radius_left_m
                weight[3] = _LEG_M / (_NOMINAL_SHARE * mean[3])
        return mean, weight

    def turns(self, ratios: FloatArray) -> FloatArray:
        """Psi of each leg (eq. 10), rad."""
        return self._Phi @ ratios

    def once(self, ratios: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Rotation and wheel ratios after one round; None where the ratios are of no use."""
        psi = self.turns(ratios)
        R_h_c = self.rotation(psi)
        ratios = self.ratios(R_h_c, psi)
        if not np.all(np.isfinite(ratios)) or np.min(np.abs(ratios)) < 1e-9:
            return None
        return R_h_c, ratios

    def run(self, ratios: FloatArray) -> Iterator[Parameters]:
        """The parameters after each round, without end unless the iteration breaks down."""
        while (found := self.once(ratios)) is not None:
            R_h_c, ratios = found
            yield self.translation(R_h_c, ratios)

    def after(self, ratios: FloatArray, rounds: int) -> Parameters:
        """The parameters after some rounds.

        Raises:
            SolveError: the iteration breaks down.
        """
        for _ in range(rounds):
            found = self.once(ratios)
            if found is None:
                raise SolveError(
                    f"the iterative linear method breaks down on these {len(self._pairs.legs)} legs",
                    "record stations between which the base turns and drives and the head pans and tilts",
                )
            R_h_c, ratios = found
        return self.translation(R_h_c, ratios)


def few_rounds(pairs: MotionPairs, ratios: FloatArray, rounds: int) -> Parameters:
    """The iterative linear solution of a few legs from wheel ratios that are nearly right.

    Raises:
        SolveError: the iteration breaks down.
    """
    return _Rounds(pairs).after(ratios, rounds)


def initial_with_prior(pairs: MotionPairs, prior: InitialPrior, seen: MotionSeen) -> Parameters:
    """The linear method with weak priors from nominal values, for motion that does not show all parameters.

    Raises:
        SolveError: wheels that the motion does not show, and no nominal ones.
    """
    if prior.wheels is None and not (seen.turns and seen.drives):
        raise SolveError(
            "the motion does not show the wheel radii and the wheel separation, and there are no nominal wheels",
            "drive and turn the base between stations, or state nominal.wheels in rig.yaml",
        )
    ratios = ratios_of(prior.wheels) if prior.wheels is not None else np.zeros(2)
    signs = (0,) if seen.tilts or prior.head_eye_fixed else (1, -1)
    found: list[tuple[float, Parameters]] = []
    for sign in signs:
        try:
            parameters = _Rounds(pairs, prior, sign).after(ratios, _PRIOR_ROUNDS)
        except SolveError:
            continue
        found.append((point_rms_m(pairs, parameters), parameters))
    if not found:
        raise SolveError(
            f"the linear method found no solution on {len(pairs.legs)} legs between stations",
            "state nominal.wheels and nominal.head_eye in rig.yaml",
        )
    upright = [item for item in found if item[1].wheels.separation_m > 0]  # upside down is a twin with b < 0
    return min(upright or found, key=lambda item: item[0])[1]


def change(before: Parameters, after: Parameters) -> float:
    """Largest relative change of a parameter, each against a sensible scale of its own."""
    turned = np.linalg.norm(se3.log_so3(before.T_h_c[:3, :3].T @ after.T_h_c[:3, :3]))
    moved = np.linalg.norm(after.T_h_c[:3, 3] - before.T_h_c[:3, 3])
    scale = max(float(np.linalg.norm(after.T_h_c[:3, 3])), _TRANSLATION_SCALE_M)
    old, new = before.wheels.vector, after.wheels.vector
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
        return bool(np.all(self.parameters.wheels.vector > 0))


def _scouted(pairs: MotionPairs, starts: list[Start]) -> list[Start]:
    """Where the starts lead on the legs that turn least, which are hard to unwrap wrongly; best first."""
    Phi = pairs.steps.totals_rad
    by_turn = np.argsort(np.abs(Phi[:, 0] - Phi[:, 1]), kind="stable")
    least = np.sort(by_turn[: max(4, min(_SCOUT_LEGS, len(Phi) // 2))])
    scout, whole = _Rounds(pairs.select(least)), _Rounds(pairs)
    found: list[tuple[float, Start]] = []
    for start in starts:
        for rounds in (scout, whole):
            history = _iterate(rounds, start.ratios, PAPER_TOLERANCE, _SCOUT_ROUNDS)
            if not history:
                continue
            ratios = ratios_of(history[-1].wheels)
            if any(np.allclose(ratios, other.ratios, rtol=0.02, atol=0) for _, other in found):
                continue
            # Two rounds on all legs show how well the guess explains the others.
            onward = _iterate(whole, ratios, PAPER_TOLERANCE, 2)
            if onward:
                found.append((point_rms_m(pairs, onward[-1]), Start(ratios, start.origin)))
    return [start for _, start in sorted(found, key=lambda item: item[0])]


def _answers(pairs: MotionPairs, starts: list[Start]) -> list[_Answer]:
    rounds = _Rounds(pairs)
    answers: list[_Answer] = []
    for start in starts:
        history = _iterate(rounds, start.ratios, FIXED_POINT, MAX_ROUNDS)
        if history:
            answers.append(_Answer(history, start, point_rms_m(pairs, history[-1])))
    return answers


def _unambiguous(pairs: MotionPairs, nominal: WheelGeometry, answer: _Answer) -> bool:
    """Whether an answer is near the nominal wheels, and no leg turns so far that it could be unwrapped otherwise."""
    turns = np.abs(pairs.steps.totals_rad @ ratios_of(nominal))
    apart = answer.parameters.wheels.vector / nominal.vector - 1
    return bool(turns.max(initial=0.0) < _UNAMBIGUOUS_RAD and np.abs(apart).max() < _NEAR_NOMINAL)


def linear_estimate(
    pairs: MotionPairs, nominal: WheelGeometry | None = None, given: FloatArray | None = None
) -> LinearEstimate:
    """The iterative linear solution, from several starts.

    A leg's turn is seen only modulo 360 degrees, so a bad guess of the wheels unwraps large turns wrongly
    and the iteration converges to another solution. Every start is therefore tried, first on the legs that turn least;
    the answer that explains all legs best is kept, one with positive wheels before its mirror images. Where
    the nominal wheels make every turn unambiguous, and the answer is near them, they are the only start.

    Args:
        pairs: at least three legs.
        nominal: nominal wheels, tried first.
        given: (2,) wheel ratios (aR, aL) to start from, tried before the nominal ones.

    Raises:
        SolveError: no start leads anywhere.
    """
    starts = []
    if given is not None:
        starts.append(Start(given, "given"))
    if nominal is not None:
        starts.append(Start(ratios_of(nominal), "nominal"))
    answers = _answers(pairs, starts)
    if nominal is None or not any(_unambiguous(pairs, nominal, answer) for answer in answers):
        answers += _answers(pairs, _scouted(pairs, starts + grid_of_starts())[:4])
    if not answers:
        raise SolveError(
            f"the iterative linear method found no answer on {len(pairs.legs)} legs between stations",
            "record stations between which the base turns and drives and the head pans and tilts",
        )
    # min() keeps the first of equals: a given or nominal start before the grid's.
    best = min(answers, key=lambda a: round(a.point_rms_m, 9))
    positive = min((a for a in answers if a.positive), key=lambda a: round(a.point_rms_m, 9), default=best)
    kept = best if best.point_rms_m < _CLEARLY_BETTER * positive.point_rms_m else positive
    rivals = [a.point_rms_m for a in answers if change(kept.parameters, a.parameters) > _SAME_ANSWER]
    steps = [math.inf, *(change(a, b) for a, b in zip(kept.history, kept.history[1:], strict=False))]
    converged = next((i for i, step in enumerate(steps, 1) if step < PAPER_TOLERANCE), len(steps))
    return LinearEstimate(
        parameters=kept.parameters,
        history=tuple(kept.history),
        rounds_to_tolerance=converged,
        point_rms_m=kept.point_rms_m,
        start_ratios=kept.start.ratios,
        start_from=kept.start.origin,
        rival_point_rms_m=min(rivals, default=math.inf),
    )
