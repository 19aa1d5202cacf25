"""Initial parameters by the iterative linear method (paper, section 3), from several starts or with weak priors.

Where the motion does not show all parameters, weak priors from the nominal values keep the method regular. If the head
never tilts, all rotation axes are parallel and Tsai-Lenz is singular: roll and pitch then come from the common axis,
and yaw from the driving direction (as for a camera without a head, Antonelli et al. 2010). If the base never moves, the
head-eye transform comes from the head's motion alone (Tsai and Lenz 1989).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import MotionSeen
from mobilecal_cli.likelihood.dataset import Dataset, Inliers
from mobilecal_cli.likelihood.measurements import MotionPairs, heading_of, planar_pose
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import LinearEstimate
from mobilecal_cli.solvers.linear import NO_SIZE_M, NominalPrior, Rounds, ratios_of
from mobilecal_cli.solvers.transfer import leg_rms_m, point_rms_m, reckoned_base

PAPER_TOLERANCE = 1e-3  # section 3.5, step 6: no parameter moves by more than 0.1 %
FIXED_POINT = 1e-13  # relative change of a parameter by rounding alone
_MOST_ANSWERS = 4  # of the grid, on all legs
MAX_ROUNDS = 200  # of a start that does not reach a fixed point
_TRANSLATION_SCALE_M = 0.1  # a component of t_X near zero must not keep the iteration from converging
_SCOUT_LEGS, _SCOUT_ROUNDS = 40, 40  # at most: the starts are many, and only lead to a guess
#: Share of the point error with positive wheels that impossible ones must reach to be kept.
CLEARLY_BETTER = 0.5
_UNAMBIGUOUS_RAD = math.radians(150)  # a guess that is wrong by less than a fifth unwraps it correctly
_NEAR_NOMINAL = 0.15  # relative error of the nominal wheels: below the fifth that unwraps correctly
_ANOTHER = 0.05  # relative change of the wheel ratios: a leg that unwraps otherwise changes them by far more
ROUNDS = 12  # where a comparison or an optimization follows, which needs no fixed point


def grid_of_starts() -> list[FloatArray]:
    """Wheel ratios (aR, aL) = (rR/b, -rL/b) to start from (eq. 11), from tiny wheels far apart to huge ones together.

    Neighbors are 15 % apart: the guess next to the truth unwraps legs of up to 360 degrees.
    """
    return [scale * np.array([1.0, -1.0]) for scale in (0.0, *np.geomspace(0.02, 2.0, 34))]


def change(before: Parameters, after: Parameters) -> float:
    """Largest relative change of a parameter, each against a sensible scale of its own."""
    turned = np.linalg.norm(se3.log_so3(before.T_h_c[:3, :3].T @ after.T_h_c[:3, :3]))
    moved = np.linalg.norm(after.T_h_c[:3, 3] - before.T_h_c[:3, 3])
    scale = max(float(np.linalg.norm(after.T_h_c[:3, 3])), _TRANSLATION_SCALE_M)
    old, new = before.wheels.vector, after.wheels.vector
    return float(max(turned, moved / scale, np.max(np.abs(new - old) / np.maximum(np.abs(new), NO_SIZE_M))))


def _iterate(rounds: Rounds, ratios: FloatArray, tolerance: float, limit: int) -> list[Parameters]:
    history: list[Parameters] = []
    for parameters in rounds.run(ratios):
        history.append(parameters)
        if len(history) >= limit or (len(history) > 1 and change(history[-2], parameters) < tolerance):
            break
    return history


def _scouted(pairs: MotionPairs, starts: list[FloatArray]) -> list[FloatArray]:
    """Where the starts lead on the legs that turn least, which are hard to unwrap wrongly; best first."""
    Phi = pairs.steps.totals_rad
    by_turn = np.argsort(np.abs(Phi[:, 0] - Phi[:, 1]), kind="stable")
    least = np.sort(by_turn[: max(4, min(_SCOUT_LEGS, len(Phi) // 2))])
    scout, whole = Rounds(pairs.select(least)), Rounds(pairs)
    scouted: list[tuple[float, FloatArray]] = []
    for start in starts:
        for rounds in (scout, whole):
            history = _iterate(rounds, start, PAPER_TOLERANCE, _SCOUT_ROUNDS)
            if not history:
                continue
            ratios = ratios_of(history[-1].wheels)
            if any(np.allclose(ratios, other, rtol=0.02, atol=0) for _, other in scouted):
                continue
            # Two rounds on all legs show how well the guess explains the others.
            onward = _iterate(whole, ratios, PAPER_TOLERANCE, 2)
            if onward:
                scouted.append((point_rms_m(pairs, onward[-1]), ratios))
    return [start for _, start in sorted(scouted, key=lambda item: item[0])]


def _answers(pairs: MotionPairs, starts: list[FloatArray], origin: str) -> Iterator[LinearEstimate]:
    """Where each start leads, without its rivals."""
    rounds = Rounds(pairs)
    for ratios in starts:
        history = _iterate(rounds, ratios, FIXED_POINT, MAX_ROUNDS)
        if history:
            steps = [math.inf, *(change(a, b) for a, b in itertools.pairwise(history))]
            converged = next((i for i, step in enumerate(steps, 1) if step < PAPER_TOLERANCE), len(steps))
            rms_m = point_rms_m(pairs, history[-1])
            yield LinearEstimate(history[-1], tuple(history), converged, rms_m, ratios, origin, math.inf)


def _unambiguous(pairs: MotionPairs, nominal: WheelGeometry, answer: LinearEstimate) -> bool:
    """Whether an answer is near the nominal wheels, and no leg turns so far that it could be unwrapped otherwise."""
    turns = np.abs(pairs.steps.totals_rad @ ratios_of(nominal))
    apart = answer.parameters.wheels.vector / nominal.vector - 1
    return bool(turns.max(initial=0.0) < _UNAMBIGUOUS_RAD and np.abs(apart).max() < _NEAR_NOMINAL)


def linear_estimate(pairs: MotionPairs, nominal: WheelGeometry | None = None) -> LinearEstimate:
    """The iterative linear solution, from several starts.

    A leg's turn is seen only modulo 360 degrees, so a bad guess of the wheels unwraps large turns wrongly
    and the iteration converges to another solution. Every start is therefore tried, first on the legs that turn least;
    the answer that explains all legs best is kept, one with positive wheels before its mirror images. Where
    the nominal wheels make every turn unambiguous, and the answer is near them, they are the only start. Impossible
    wheels are no rivals of possible ones.

    Args:
        pairs: at least three legs.
        nominal: nominal wheels, tried first.

    Raises:
        SolveError: no start leads anywhere.
    """
    starts = [] if nominal is None else [ratios_of(nominal)]
    answers = list(_answers(pairs, starts, "nominal"))
    if nominal is None or not any(_unambiguous(pairs, nominal, answer) for answer in answers):
        answers += _answers(pairs, _scouted(pairs, grid_of_starts())[:_MOST_ANSWERS], "grid")
    if not answers:
        raise SolveError(
            f"the iterative linear method found no answer on {len(pairs.legs)} legs between stations",
            "record stations between which the base turns and drives and the head pans and tilts",
        )
    # The sort keeps the order of equals: a nominal start before the grid's.
    answers.sort(key=lambda a: round(a.point_rms_m, 9))
    best = answers[0]
    positive = next((a for a in answers if a.parameters.wheels.positive), best)
    kept = best if best.point_rms_m < CLEARLY_BETTER * positive.point_rms_m else positive
    ratios = ratios_of(kept.parameters.wheels)
    rivals = [
        a.point_rms_m
        for a in answers
        if np.abs(ratios_of(a.parameters.wheels) / ratios - 1).max() > _ANOTHER
        and (a.parameters.wheels.positive or not kept.parameters.wheels.positive)
    ]
    return replace(kept, rival_point_rms_m=min(rivals, default=math.inf))


def linear_with_prior(pairs: MotionPairs, prior: NominalPrior, motion: MotionSeen) -> Parameters:
    """The linear method with weak priors from nominal values, for motion that does not show all parameters.

    Or the nominal values themselves, where most legs agree better with them, and where neither head nor base turns: the
    axes of rotation are noise of the floor then.

    Raises:
        SolveError: wheels that the motion does not show, and no nominal ones.
    """
    if prior.wheels is None and not motion.shows_wheels:
        raise SolveError(
            "the motion does not show the wheel radii and the wheel separation, and there are no nominal wheels",
            "drive and turn the base between stations, or state nominal.wheels in rig.yaml",
        )
    ratios = ratios_of(prior.wheels) if prior.wheels is not None else np.zeros(2)
    solutions = [] if prior.T_h_c is None or prior.wheels is None else [Parameters(prior.T_h_c, prior.wheels)]
    if solutions and not (motion.tilts or motion.turns):
        return solutions[0]
    signs = (0,) if motion.tilts or prior.head_eye_fixed else (1, -1)
    for sign in signs:
        try:
            solutions.append(Rounds(pairs, prior, sign).after(ratios, ROUNDS))
        except SolveError:
            continue
    if not solutions:
        raise SolveError(
            f"the linear method found no solution on {len(pairs.legs)} legs between stations",
            "state nominal.wheels and nominal.head_eye in rig.yaml",
        )
    upright = [item for item in solutions if item.wheels.separation_m > 0] or solutions  # upside down, b < 0
    misfits = [float(np.median(leg_rms_m(pairs, item))) for item in upright]
    # Legs of one curvature fit as well with a camera that is upside down: one as good that is not comes first.
    worse = [
        CLEARLY_BETTER * misfit > min(misfits) or _turned_around(item.T_h_c, prior)
        for misfit, item in zip(misfits, upright, strict=True)
    ]
    return min(zip(worse, misfits, upright, strict=True), key=lambda each: each[:2])[2]


def _turned_around(T_h_c: FloatArray, prior: NominalPrior) -> bool:
    """Whether a camera is turned by more than a right angle from the nominal rotation."""
    if prior.T_h_c is None:
        return False
    turn = se3.log_so3(prior.T_h_c[:3, :3].T @ T_h_c[:3, :3])
    return float(np.linalg.norm(turn)) > np.pi / 2


def start_state(data: Dataset, parameters: Parameters, inliers: Inliers) -> State:
    """Base poses by dead reckoning with some parameters, and the boards' median poses.

    After an outlier leg, the images of the board place the base.
    """
    pairs = data.pairs
    base = reckoned_base(pairs, parameters.wheels)
    T_v_k = pairs.T_v_h @ parameters.T_h_c @ pairs.T_c_k
    boards = np.broadcast_to(np.eye(4), (data.logs, 4, 4)).copy()
    known, alone = np.zeros(data.logs, dtype=np.bool_), data.first
    alone[data.legs[~inliers.legs, 1]] = True
    starts = np.flatnonzero(alone).tolist()
    for start, end in zip(starts, [*starts[1:], data.stations], strict=True):
        log, seeing = data.log[start], start + np.flatnonzero(inliers.views[start:end])
        if len(seeing) and known[log]:  # where the board is places the first station, and all after it
            later = slice(start, np.searchsorted(data.log, log, side="right"))
            T_start_v = se3.inverse(planar_pose(base[start])) @ planar_pose(base[later])
            placed = boards[log] @ se3.inverse(T_v_k[seeing]) @ se3.inverse(T_start_v[seeing - start])
            shift = _median_pose(placed)
            flat = np.array([*shift[:2, 3], heading_of(shift)])
            base[later, 2] += flat[2] - base[start, 2]
            base[later, :2] = (planar_pose(flat) @ T_start_v)[:, :2, 3]
        elif len(seeing):
            boards[log], known[log] = _median_pose(planar_pose(base[seeing]) @ T_v_k[seeing]), True
    for log in np.intersect1d(np.flatnonzero(~known), data.log):
        boards[log] = _median_pose((planar_pose(base) @ T_v_k)[data.log == log])
    return State.without_errors(data, parameters, boards, base)


def _median_pose(T: FloatArray) -> FloatArray:
    """A pose in the middle of several: medians of the twists from one of them."""
    best: FloatArray = T[len(T) // 2]
    for _ in range(3 if len(T) > 2 else 0):
        best = best @ se3.exp(np.median(se3.log(se3.inverse(best) @ T), axis=0))
    return best
