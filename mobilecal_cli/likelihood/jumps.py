"""Jumps: something has one value up to a moment, and another from there to the end of the recording.

For each leg of a recording and each part of the robot, the score test (Rao, 1948) of an additional step of that part
from the leg's end on, and for each of several recordings, of a step in all of it: with the gradient g of half the sum
of squares by the step, and its information I after all other unknowns are eliminated, ``g^T I^-1 g`` is chi-squared
without a change. The step is then ``-I^-1 g``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betainc, gammaln

from mobilecal_cli import se3
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import POSE, BoardEffect, CameraEffect
from mobilecal_cli.likelihood.evidence import equivalent_sigmas, from_chance
from mobilecal_cli.likelihood.legs import residuals_moved
from mobilecal_cli.likelihood.measurements import FLOOR
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.rig import camera_words

_FEWEST_EACH_SIDE = 2  # stations before and after a change: one alone is an outlier
_MOST_MOMENTS = 60  # that are compared; around the best one, all
_FAINT = 400.0  # 1/rad^2, 1/m^2: a step of 0.05 rad or m does not show; derivatives say little about it
_ALIKE = 6.0  # twice the logarithm of how much likelier one part is than another that it may be confused with
#: The parts that differ between recordings alone: with different boards, and with another load or tire pressure.
BETWEEN = SIZE, SHAPE, BOTH_WHEELS = "board's size", "board's shape", "both wheels"
#: Roll, pitch and height of the base, beside a head that turns.
LEAN = "lean of the base"
_SINKS_M = 0.01  # of a base that leans over: a larger step of the height is the board's
#: How the part is called that is one camera's focal length, or that of all.
FOCAL = "focal length of "
#: Parts that are wheels → which of the radii they have, of the right and the left one.
WHEELS = {"right wheel": [0], "left wheel": [1], BOTH_WHEELS: [0, 1]}


@dataclass(frozen=True, slots=True, eq=False)
class ScoredJump:
    """A step of one part.

    Attributes:
        part: "head mount", "joint <name>", "board", `LEAN`, "<name> camera", "focal length of the <name> camera",
            "right wheel", "left wheel", `BOTH_WHEELS`, `SIZE` or `SHAPE`.
        station: index of the first station after it; the first of a recording that differs from the others.
        chi2, dof: of the score test.
        tried: number of parts and moments of its kind, inside recordings or between them, that were compared; of both
            kinds, where there are both.
        sigmas: standard deviations of a normal distribution with the same chance, for the best of all that were tried.
        shift_sigmas: how far the jump moves the nine parameters, or is itself in their units: the largest, in standard
            deviations; the rotation of a camera against the first one in those of its prior.
        value: (m,) the step: twist of the camera in the head (rad, m), rad or m of the joint, twist of the board in its
            own frame (rad, m), roll, pitch and height of the base (rad, m), rotation and position of a camera against
            the first one (rad, m), share of the focal length, m of the radius, or of both radii, or constants of the
            board, in units of a few prior sigmas.
        also: another part that explains about the same; "" if none does.
    """

    part: str
    station: int
    chi2: float
    dof: int
    tried: int
    sigmas: float
    shift_sigmas: float
    value: FloatArray
    also: str = ""


#: Derivatives by a part's m numbers: (N, T, m) of the traced unknowns, and (L, K, m) of the legs' ends.
_Part = tuple[FloatArray, FloatArray]


def _parts(lin: Posterior, between: bool) -> dict[str, _Part]:
    """Parts that change inside a recording, or between recordings.

    Each recording has a place of the board of its own: so the height of a camera that never tilts shows inside alone.
    """
    data, views, residuals = lin.data, lin.views, lin.legs.residual

    def of_images(unknowns: Sequence[int], columns: FloatArray) -> _Part:
        by_images = np.zeros((*views.pull.shape, columns.shape[-1]))
        by_images[:, [views.traced.tolist().index(unknown) for unknown in unknowns]] = columns
        return by_images, np.zeros((*residuals.shape, columns.shape[-1]))

    delta, of_mount, vertical = range(6), views.by_shared[:, :, :6].copy(), unseen_height(data.chain)
    if between and vertical is not None:
        of_mount[..., 3:] -= np.outer(of_mount[..., 3:] @ vertical, vertical).reshape(of_mount[..., 3:].shape)
    parts = {"head mount": of_images(delta, of_mount)}
    for j, name in enumerate(data.chain.joints):
        parts[f"joint {name}"] = of_images(delta, views.by_own[:, :, j : j + 1])
    parts["board"] = of_images(delta, se3.adjoint(lin.state.T_c_k))
    if data.chain.joints:  # a camera on the base moves with it
        parts[LEAN] = of_images(delta, views.by_base[:, :, FLOOR])
    for name, own in _constants(data).items():
        # Of the board, a step of a prior sigma shows as well as the least step of a pose that is regarded.
        sigmas = math.sqrt(_FAINT) * lin.priors.scales[views.columns[own]]
        parts[name] = of_images(
            [6 + k for k in own], np.diag(sigmas if name in BETWEEN else np.ones(len(own)))
        )
    for name, radii in WHEELS.items():
        no_images = np.zeros((*views.pull.shape, len(radii)))
        parts[name] = no_images, lin.legs.by_shared[:, :, 6:8][:, :, radii]
    others = ("board", LEAN) if between else BETWEEN
    return {name: part for name, part in parts.items() if name not in others}


def _part_of(lin: Posterior, jump: ScoredJump) -> _Part:
    first = jump.station == np.flatnonzero(lin.data.log == lin.data.log[jump.station])[0]
    return _parts(lin, bool(first))[jump.part]


def traced(lin: Posterior) -> Posterior:
    """The same point, with all constants that a jump may change traced: see `Views`."""
    return lin.tracing(tuple(6 + k for of_part in _constants(lin.data).values() for k in of_part))


def _constants(data: Dataset) -> dict[str, list[int]]:
    """Direct constants of each part: a camera's pose in the first one, focal lengths, the board's size or shape.

    Those of the board where recordings may differ in them.
    """
    parts, names = dict[str, list[int]](), data.cameras.names
    for k, (_, name, effect) in enumerate(data.layout.direct):
        if isinstance(effect, CameraEffect) and effect.camera and effect.of in POSE:
            parts.setdefault(camera_words(names[effect.camera]), []).append(k)
        elif isinstance(effect, CameraEffect) and name == f"focal_{names[effect.camera or 0]}":
            parts[f"{FOCAL}the {camera_words(names[effect.camera or 0])}"] = [k]
            if len(names) > 1:
                parts.setdefault(f"{FOCAL}all cameras", []).append(k)
        elif isinstance(effect, BoardEffect) and data.logs > 1:
            parts.setdefault(SIZE if name == "square_scale" else SHAPE, []).append(k)
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class _Scores:
    """Score tests of k steps of m numbers.

    Attributes:
        information: (k, m, m) about each.
        chi2, dof: (k,) of the tests.
        value: (k, m) the steps.
    """

    information: FloatArray
    chi2: FloatArray
    dof: IntArray
    value: FloatArray


def _scores(lin: Posterior, part: _Part, stations: Sequence[int] | IntArray, lasting: bool = True) -> _Scores:
    """Score tests of a step before each of some stations.

    Args:
        lin: an optimum.
        part: what changes.
        stations: (k,) indices of the first stations after it.
        lasting: to the end of the recording; else at this station alone, or in the leg that ends there.
    """
    data, views, legs, normal = lin.data, lin.views, lin.legs, lin.normal
    first, numbers = np.asarray(stations, dtype=np.int64)[:, None], np.arange(data.stations)
    after = (data.log == data.log[first]) & (numbers >= first) if lasting else numbers == first
    driven = after[:, data.legs[:, 1]].astype(np.float64)
    after = after.astype(np.float64)

    # Station by station and leg by leg: the gradient, the information, and that with all other unknowns.
    V, D = part
    GV, WD = lin.station_rows.mT @ V, lin.leg_weight @ D
    of_images = (
        np.einsum("nqm,nq->nm", V, views.pull),
        V.mT @ GV[:, views.traced],
        views.by_board.mT @ GV[:, :6],
        views.onto_shared(GV.mT, views.by_shared).mT,
    )
    of_legs = (
        np.einsum("lam,la->lm", WD, legs.residual),
        D.mT @ WD,
        legs.by_shared.mT @ WD,
    )
    gradient, own, board, shared = (np.tensordot(after, each, 1) for each in of_images)
    for total, each in zip((gradient, own, shared), of_legs, strict=True):
        total += np.tensordot(driven, each, 1)
    # (N, B, k, m): of the chain of base blocks, all steps side by side.
    base = after.T[:, None, :, None] * (views.by_base.mT @ GV[:, :6])[:, :, None]
    for ends, by in zip(data.legs.T, (legs.by_start, legs.by_end), strict=True):
        base[ends] += driven.T[:, None, :, None] * (by.mT @ WD)[:, :, None]

    rows, (k, m) = data.stations * data.base_width, base.shape[2:]
    flat = base.reshape(rows, k * m)
    solved = normal.stations.solve(base.reshape(*base.shape[:2], k * m))
    log = data.log[first[:, 0]]
    shared += normal.board_by_shared[log].mT @ board
    for total, by in ((shared, normal.base_by_shared), (board, normal.base_by_board)):
        onto = by.reshape(rows, by.shape[2]).T @ flat
        total += np.moveaxis(onto.reshape(len(onto), k, m), 1, 0)
    each, solved = (np.moveaxis(part.reshape(rows, k, m), 1, 0) for part in (flat, solved))
    information = own - each.mT @ solved
    for A, C in ((board, normal.board_covariance[log]), (shared, lin.conditional_covariance)):
        information -= A.mT @ C @ A

    values, vectors = np.linalg.eigh(information)
    shown = values > _FAINT
    along = np.einsum("kmi,km->ki", vectors, gradient)
    over = np.where(shown, along / np.where(shown, values, 1.0), 0.0)
    value = -np.einsum("kmi,ki->km", vectors, over)
    return _Scores(information, np.sum(along * over, axis=1), shown.sum(axis=1), value)


def without(lin: Posterior, jump: ScoredJump, large: bool = False) -> Posterior:
    """The same point with the residuals that remain after a step, to first order; a large one of wheels exactly.

    To first order, the derivatives may be those midway between the wheels before and after; a large step begins at the
    point.
    """
    (of_views, of_legs), after = _part_of(lin, jump), stations_after(lin, jump.station)
    images = lin.images.shifted(np.where(after[:, None], of_views @ jump.value, 0.0))
    moved = of_legs @ jump.value
    if large and jump.part in WHEELS:
        step = np.zeros(lin.data.layout.size)
        step[6:8][WHEELS[jump.part]] = jump.value
        moved = residuals_moved(lin.state, step, lin.processes)
    offset = np.where(after[lin.data.legs[:, 1], None], moved, 0.0)
    return lin.changed(known={"images": images}, leg_offset=lin.leg_offset + offset)


def again(lin: Posterior, jump: ScoredJump) -> ScoredJump:
    """The test of a step whose residuals have been taken out, at other noise levels, and the step there."""
    score = _scores(lin, _part_of(lin, jump), [jump.station])
    value = jump.value + score.value[0]
    chi2 = float(value @ score.information[0] @ value)
    return replace(jump, chi2=chi2, value=value, sigmas=equivalent_sigmas(chi2, jump.dof, jump.tried))


def slides(data: Dataset, jump: ScoredJump) -> bool:
    """Whether the part is a prismatic joint."""
    return jump.part.removeprefix("joint ") in data.chain.prismatic


def turning(data: Dataset, jump: ScoredJump) -> BoolArray:
    """(m,) which numbers of a step are a rotation about the axes of its part, rad."""
    constants = _constants(data)
    if jump.part in constants:
        effects = (data.layout.direct[k][2] for k in constants[jump.part])
        return np.array([isinstance(effect, CameraEffect) and effect.of == "turn" for effect in effects])
    turns = not slides(data, jump) and jump.part not in WHEELS
    return np.arange(len(jump.value)) < ((2 if jump.part == LEAN else 3) if turns else 0)


def left_by_first_order(lin: Posterior, jump: ScoredJump) -> float:
    """Chi-squared of what is left of a step that was taken out to first order: of a turn by t, t / 2 of its effect."""
    turn = jump.value[turning(lin.data, jump)]
    return jump.chi2 * float(turn @ turn) / 4


def scatter(lin: Posterior, jump: ScoredJump) -> float:
    """How many times as far a part is off at single stations, or in single legs, as the noise levels say; in variance.

    The mean of the score tests of the part at some stations alone, over its expectation. At least 1.

    Args:
        lin: the point without the residuals of the jump.
        jump: of the part.
    """
    stations = np.unique(lin.data.legs[lin.inliers.legs, 1])
    stations = stations[lin.inliers.views[stations]][:: max(1, len(stations) // _MOST_MOMENTS)]
    single = _scores(lin, _part_of(lin, jump), stations, lasting=False)
    return max(1.0, float(single.chi2.sum()) / max(int(single.dof.sum()), 1))


def shift(written: Posterior, covariance: FloatArray, lin: Posterior, jump: ScoredJump) -> float:
    """How far a jump moves the nine parameters that are written, or is itself in their units: see `ScoredJump`.

    Args:
        written: the result, which takes no jump into account.
        covariance: (P, P) of the result.
        lin: the point without the residuals of the jump.
        jump: from `again`.
    """
    moved = lin.state.parameters.minus(written.state.parameters)
    return max(_in_sigmas(moved, np.diag(covariance)[:9]), _own_sigmas(lin, jump))


def _own_sigmas(lin: Posterior, jump: ScoredJump) -> float:
    covariance, size, constants = lin.covariance, np.abs(jump.value), _constants(lin.data)
    variance = np.diag(covariance)
    if jump.part == "head mount":
        return _in_sigmas(size, variance[:6])
    if jump.part.startswith("joint"):
        return _in_sigmas(size, variance[3:6] if slides(lin.data, jump) else variance[:3])
    if jump.part in WHEELS:  # alone: all three may have a common scale that hardly shows
        known = np.diag(np.linalg.pinv(covariance[6:9, 6:9], hermitian=True))[WHEELS[jump.part]]
        return float(np.max(size * np.sqrt(np.maximum(known, 0.0))))
    if jump.part in constants:
        # A rotation, by what is known before: the images alone show far smaller drifts.
        turns = turning(lin.data, jump)
        columns = lin.views.columns[np.array(constants[jump.part])[turns]]
        return _in_sigmas(size[turns], lin.priors.scales[columns] ** 2)
    return 0.0


def _in_sigmas(step: FloatArray, variance: FloatArray) -> float:
    return float(np.max(np.abs(step) / np.sqrt(np.where(variance > 0, variance, np.inf)), initial=0.0))


def significance(optimum: Posterior, lin: Posterior, jump: ScoredJump) -> float:
    """`ScoredJump.sigmas` by an F test, as a jump may itself have made the noise levels without it small.

    With n residuals that the levels rest on, the score of a jump of m numbers is S at levels with its residuals, and
    chi2 = S / (1 - S / n) at those without. Both show n; S / n has Beta's distribution with m / 2 and (n - m) / 2.

    A part that is off at single stations by more than the levels say, has to jump further by as much.

    Args:
        optimum: the one whose noise levels rest on the residuals of the jump, too; `traced`.
        lin: the point without them.
        jump: from `again`, at levels without its residuals.
    """
    test = _scores(optimum, _part_of(optimum, jump), [jump.station])
    score, dof, chi2 = float(test.chi2[0]), int(test.dof[0]), jump.chi2 / scatter(lin, jump)
    if score >= jump.chi2 or not dof:
        return equivalent_sigmas(chi2, jump.dof, jump.tried)
    residuals = 1 / (1 / score - 1 / jump.chi2)
    if residuals <= dof:
        return 0.0
    chance = float(betainc((residuals - dof) / 2, dof / 2, 1 / (1 + chi2 / residuals)))
    return from_chance(min(1.0, chance * jump.tried))


def alike(ranked: Sequence[ScoredJump]) -> list[ScoredJump]:
    """Other jumps that are hardly less probable than the first of `likeliest`."""
    of_each = ([getattr(jump, name) for jump in ranked] for name in ("chi2", "dof", "tried"))
    rank = _rank(*map(np.array, of_each))
    return [jump for jump, mine in zip(ranked[1:], rank[1:], strict=True) if mine > rank[0] - _ALIKE]


def _rank(chi2: FloatArray, dof: IntArray, tried: IntArray) -> FloatArray:
    """(k,) minus twice the logarithm of the chance of the best of some chi-squared values, far out in the tail.

    It is -inf for none. Something changes between two recordings as likely as at all moments inside them together.
    """
    rank = chi2 - (dof - 2) * np.log(np.maximum(chi2, 2.0) / 2) + 2 * gammaln(np.maximum(dof, 1) / 2)
    return np.where(dof > 0, rank - 2 * np.log(tried), -np.inf)


def stations_after(lin: Posterior, first: int) -> BoolArray:
    """(N,) stations of the same recording from a station on."""
    log = lin.data.log
    return np.asarray((log == log[first]) & (np.arange(len(log)) >= first))


def likeliest(lin: Posterior) -> list[ScoredJump]:
    """The most probable jump of each part at an optimum that is `traced`, the best first, significant or not."""
    data = lin.data
    logs, starts, stations = np.unique(data.log, return_index=True, return_counts=True)
    # Of two recordings, either may be the one that differs; one of a single leg is an outlier.
    differing = starts[stations > _FEWEST_EACH_SIDE][len(logs) <= 2 :].tolist()
    inside: list[int] = []
    for log in logs:
        mine = np.flatnonzero((data.log == log) & lin.inliers.views)
        inside += mine[_FEWEST_EACH_SIDE : len(mine) - _FEWEST_EACH_SIDE + 1].tolist()
    kinds = 1 + bool(differing and inside)
    ranked: list[tuple[float, ScoredJump]] = []
    for between, of_kind in ((False, inside), (True, differing)):
        if not of_kind:
            continue
        parts = _parts(lin, between)
        tried = np.array(kinds * len(parts) * len(of_kind))
        for name, part in parts.items():
            moments = np.array(of_kind, dtype=np.int64)
            every = max(1, math.ceil(len(moments) / _MOST_MOMENTS))
            tests = _scores(lin, part, moments[::every])
            if every > 1:
                near = every * int(np.argmax(_rank(tests.chi2, tests.dof, tried)))
                moments = moments[max(near - every + 1, 0) : near + every]
                tests = _scores(lin, part, moments)
            rank = _rank(tests.chi2, tests.dof, tried)
            if np.isfinite(rank).any():
                k, count = int(np.argmax(rank)), int(tried)
                chi2, dof, value = float(tests.chi2[k]), int(tests.dof[k]), tests.value[k]
                if name == LEAN and abs(value[2]) > _SINKS_M:
                    continue
                sigmas = equivalent_sigmas(chi2, dof, count)
                jump = ScoredJump(name, int(moments[k]), chi2, dof, count, sigmas, 0.0, value)
                ranked.append((-float(rank[k]), jump))
    best: dict[str, ScoredJump] = {}
    for _, jump in sorted(ranked, key=lambda each: each[0]):
        best.setdefault(jump.part, jump)
    return list(best.values())


def lasts(lin: Posterior, jump: ScoredJump) -> bool:
    """Whether a jump explains more than a deviation of one station, or leg, next to it does.

    Args:
        lin: the optimum with its residuals.
        jump: from `likeliest` there.
    """
    legs, log = lin.data.legs, lin.data.log
    beside = np.arange(jump.station - _FEWEST_EACH_SIDE, jump.station + _FEWEST_EACH_SIDE)
    beside = np.intersect1d(beside, legs[log[legs[:, 1]] == log[jump.station], 1])
    single = _scores(lin, _part_of(lin, jump), beside, lasting=False)
    return float(single.chi2.max(initial=0.0)) < jump.chi2
