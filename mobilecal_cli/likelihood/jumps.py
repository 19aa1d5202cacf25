"""Jumps: something has one value up to a moment, and another from there to the end of the recording.

For each leg of a recording and each part of the robot, the score test (Rao, 1948) of an additional step of that part
from the leg's end on, and for each of several recordings, of a step in all of it: with the gradient g of half the sum
of squares by the step, and its information I after all other unknowns are eliminated, ``g^T I^-1 g`` is chi-squared
without a change. The step is then ``-I^-1 g``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded
from scipy.special import betainc, chdtrc

from mobilecal_cli import se3
from mobilecal_cli.likelihood.effects import POSE, BoardEffect, CameraEffect
from mobilecal_cli.likelihood.evidence import from_chance
from mobilecal_cli.likelihood.normal import station_information
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import board_in_camera
from mobilecal_cli.model import BoolArray, FloatArray, IntArray, camera_words

_FEWEST_EACH_SIDE = 3  # stations before and after a change
_MOST_MOMENTS = 60  # that are compared; around the best one, all
_FAINT = 400.0  # 1/rad^2, 1/m^2: a step of 0.05 rad or m does not show; derivatives say little about it
_ALIKE = 6.0  # twice the logarithm of how much likelier one part is than another that it may be confused with
_EXPLAINED = 0.3  # of a misfit, that a jump may leave
#: The part that differs where recordings have different boards.
SHAPE = "board's shape"


@dataclass(frozen=True, slots=True, eq=False)
class Jump:
    """A step of one part.

    Attributes:
        part: "head mount", "joint <name>", "board", "<name> camera", "right wheel", "left wheel" or `SHAPE`.
        station: index of the first station after it; the first of a recording that differs from the others.
        chi2, dof: of the score test.
        tried: number of parts and moments that were compared.
        sigmas: standard deviations of a normal distribution with the same chance, for the best of all that were tried.
        shift_sigmas: how far the jump moves the nine parameters, or is itself in their units: the largest, in standard
            deviations.
        value: (m,) the step: twist of the camera in the head (rad, m), rad or m of the joint, twist of the board in its
            own frame (rad, m), rotation and position of a camera against the first one (rad, m), m of the radius, or
            constants of the board, in units of a few prior sigmas.
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


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Derivatives by a part's m numbers: of (delta, direct constants), (N, Q, m), or of the legs' ends, (L, 3, m)."""

    views: FloatArray | None = None
    legs: FloatArray | None = None


def _parts(lin: Posterior) -> Iterator[tuple[str, _Part]]:
    data, views = lin.data, lin.views
    count, Q = len(views.information), views.information.shape[1]

    def of_delta(columns: FloatArray) -> _Part:
        out = np.zeros((count, Q, columns.shape[2]))
        out[:, :6] = columns
        return _Part(views=out)

    def of_direct(columns: Sequence[int], units: FloatArray | float = 1.0) -> _Part:
        out = np.zeros((count, Q, len(columns)))
        out[:, [6 + k for k in columns], range(len(columns))] = units
        return _Part(views=out)

    effects = [effect for _, _, effect in data.layout.direct]
    yield "head mount", of_delta(views.by_shared[:, :, :6])
    for j, name in enumerate(data.chain.joints):
        yield f"joint {name}", of_delta(views.by_own[:, :, j : j + 1])
    yield "board", of_delta(se3.adjoint(board_in_camera(data, lin.state)))
    for camera, name in enumerate(data.cameras.names[1:], 1):
        own = [
            k
            for k, effect in enumerate(effects)
            if isinstance(effect, CameraEffect) and effect.camera == camera and effect.of in POSE
        ]
        if own:
            yield camera_words(name), of_direct(own)
    shape = [k for k, effect in enumerate(effects) if isinstance(effect, BoardEffect)]
    if shape and data.logs > 1:
        # A step of a prior sigma shows as well as the least step of a pose that is regarded.
        yield SHAPE, of_direct(shape, math.sqrt(_FAINT) * lin.priors.scales[views.direct[shape]])
    for k, side in enumerate(("right", "left")):
        yield f"{side} wheel", _Part(legs=lin.legs.by_shared[:, :, 6 + k : 7 + k])


class _Test:
    """Score tests at an optimum."""

    def __init__(self, lin: Posterior) -> None:
        self._lin = lin
        self._G = station_information(lin)
        self._normal = lin.normal
        self._C = lin.conditional_covariance
        self._leg_shared = lin.legs.by_shared

    def terms(
        self, part: _Part, stations: IntArray, lasting: bool = True
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """For a step before each of some stations: gradient (m,) by the step, and its information (m, m).

        Args:
            part: what changes.
            stations: indices of the first stations after it.
            lasting: to the end of the recording; else at this station alone, or in the leg that ends there.
        """
        lin, count = self._lin, self._lin.data.stations
        P, B = lin.data.layout.size, lin.data.base_width
        gradient, own, base, start, board, shared = self._by_station(part)
        m = gradient.shape[1]
        after = np.zeros((len(stations), count))
        for row, first in zip(after, stations.tolist(), strict=True):
            row[_after(lin, first) if lasting else first] = 1.0
        gradients, owns, boards, shares = (
            np.tensordot(after, each, 1) for each in (gradient, own, board, shared)
        )
        i, j = lin.data.legs.T
        of_leg = np.zeros_like(after)
        of_leg[:, i] = after[:, j]
        coupled = after[:, :, None, None] * base + of_leg[:, :, None, None] * start
        flat = np.moveaxis(coupled, 0, 2).reshape(count * B, -1)
        solved = cho_solve_banded((self._normal.factor, True), flat, check_finite=False)
        normal, logs = self._normal, lin.data.log[stations]
        for k, log in enumerate(logs.tolist()):
            at, mine = flat[:, k * m : (k + 1) * m], lin.data.log == log
            rows = np.repeat(mine, B)
            with_board = boards[k] + normal.base_by_board[mine].reshape(-1, 6).T @ at[rows]
            across = shares[k] + normal.board_by_shared[log].T @ boards[k]
            across += normal.base_by_shared[mine].reshape(-1, P).T @ at[rows]
            information = owns[k] - at.T @ solved[:, k * m : (k + 1) * m] - across.T @ self._C @ across
            information -= with_board.T @ normal.board_covariance[log] @ with_board
            yield gradients[k], information

    def _by_station(self, part: _Part) -> tuple[FloatArray, ...]:
        """What each station, and the leg that ends there, says of a part.

        (N, m) gradient, (N, m, m) information, that with the station's base block, (N, B, m), with that of the start of
        the leg, at the start's row, (N, B, m), with the board (N, 6, m), and with the shared parameters (N, P, m).
        """
        lin, data = self._lin, self._lin.data
        count, P, B = data.stations, data.layout.size, data.base_width
        if part.views is not None:
            V, views = part.views, lin.views
            GV = self._G @ V
            Vt = np.swapaxes(V, 1, 2)
            base = np.swapaxes(views.by_base, 1, 2) @ GV[:, :6]
            shared = np.swapaxes(views.onto_shared(np.swapaxes(GV, 1, 2)), 1, 2)
            board = np.swapaxes(views.by_board, 1, 2) @ GV[:, :6]
            return (Vt @ views.gradient[..., None])[..., 0], Vt @ GV, base, np.zeros_like(base), board, shared
        assert part.legs is not None
        i, j = data.legs.T
        D, legs = part.legs, lin.legs
        WD = lin.leg_weight @ D
        m = D.shape[2]
        gradient, own = np.zeros((count, m)), np.zeros((count, m, m))
        base, start, shared = np.zeros((count, B, m)), np.zeros((count, B, m)), np.zeros((count, P, m))
        gradient[j] = np.einsum("laq,la->lq", WD, legs.residual)
        own[j] = np.swapaxes(D, 1, 2) @ WD
        base[j] = np.swapaxes(legs.by_end, 1, 2) @ WD
        start[i] = np.swapaxes(legs.by_start, 1, 2) @ WD
        shared[j] = np.swapaxes(self._leg_shared, 1, 2) @ WD
        return gradient, own, base, start, np.zeros((count, 6, m)), shared


def _terms(
    lin: Posterior, part: str, stations: IntArray, lasting: bool = True
) -> list[tuple[FloatArray, FloatArray]]:
    """`_Test.terms` of one part."""
    return list(_Test(lin).terms(dict(_parts(lin))[part], stations, lasting)) if len(stations) else []


def _score(g: FloatArray, information: FloatArray) -> tuple[float, int, FloatArray]:
    values, vectors = np.linalg.eigh(information)
    shown = values > _FAINT
    along = vectors.T @ g
    over = np.where(shown, along / np.where(shown, values, 1.0), 0.0)
    return float(along @ over), int(shown.sum()), -(vectors @ over)


def without(lin: Posterior, jump: Jump) -> Posterior:
    """The same point with the residuals that remain after a step, to first order."""
    data, part = lin.data, dict(_parts(lin))[jump.part]
    after = _after(lin, jump.station)
    views, offset = lin.views, lin.leg_offset
    if part.views is not None:
        views = views.shifted(np.where(after[:, None], part.views @ jump.value, 0.0))
    if part.legs is not None:
        offset = offset + np.where(after[data.legs[:, 1], None], part.legs @ jump.value, 0.0)
    return lin.changed(known={"views": views}, leg_offset=offset)


def again(lin: Posterior, jump: Jump) -> Jump:
    """The test of a step whose residuals have been taken out, at other noise levels, and the step there."""
    ((gradient, information),) = _terms(lin, jump.part, np.array([jump.station]))
    value = jump.value + _score(gradient, information)[2]
    chi2 = float(value @ information @ value)
    return replace(jump, chi2=chi2, value=value, sigmas=_significance(chi2, jump.dof, jump.tried))


def scatter(lin: Posterior, jump: Jump) -> float:
    """How many times as far a part is off at single stations, or in single legs, as the noise levels say; in variance.

    The mean of the score tests of the part at some stations alone, over its expectation. At least 1.

    Args:
        lin: the point without the residuals of the jump.
        jump: of the part.
    """
    stations = np.unique(lin.data.legs[lin.inliers.legs, 1])
    stations = stations[lin.inliers.views[stations]][:: max(1, len(stations) // _MOST_MOMENTS)]
    scores = [_score(*each) for each in _terms(lin, jump.part, stations, lasting=False)]
    dof = sum(score[1] for score in scores)
    return max(1.0, sum(score[0] for score in scores) / dof) if dof else 1.0


def shift(written: Posterior, covariance: FloatArray, lin: Posterior, jump: Jump) -> float:
    """How far a jump moves the nine parameters that are written, or is itself in their units: see `Jump`.

    Args:
        written: the result, which takes no jump into account.
        covariance: (P, P) of the result.
        lin: the point without the residuals of the jump.
        jump: from `again`.
    """
    moved = lin.state.parameters.minus(written.state.parameters)
    return max(_in_sigmas(moved, np.diag(covariance)[:9]), _own_sigmas(lin.covariance, jump))


def _own_sigmas(covariance: FloatArray, jump: Jump) -> float:
    variance, size = np.diag(covariance), np.abs(jump.value)
    if jump.part == "head mount":
        return _in_sigmas(size, variance[:6])
    if jump.part.startswith("joint"):
        return _in_sigmas(size, variance[:3].min(keepdims=True))
    if jump.part.endswith("wheel"):  # alone: all three may have a common scale that hardly shows
        known = np.linalg.pinv(covariance[6:9, 6:9], hermitian=True)
        k = int(jump.part == "left wheel")
        return float(size[0] * math.sqrt(max(known[k, k], 0.0)))
    return 0.0


def _in_sigmas(step: FloatArray, variance: FloatArray) -> float:
    return float(np.max(np.abs(step) / np.sqrt(np.where(variance > 0, variance, np.inf))))


def cause(lin: Posterior, first: int) -> str:
    """The part whose jump at a station explains most of the misfit from there on; "" if none explains nearly all.

    Args:
        lin: a point at which the misfit is part of the measurements.
        first: index of the first station after it.
    """
    try:
        test = _Test(lin)
    except np.linalg.LinAlgError:
        return ""  # these stations are so far off that no derivative says anything about them
    parts, after = dict(_parts(lin)), _after(lin, first)
    before = float(lin.views.cost[after].sum())
    best, least = "", _EXPLAINED * before
    for name, part in parts.items():
        if part.views is None:
            continue
        ((gradient, information),) = test.terms(part, np.array([first]))
        chi2, dof, value = _score(gradient, information)
        left = without(lin, Jump(name, first, chi2, dof, 1, 0.0, 0.0, value)).views.cost[after].sum()
        if left < least:
            best, least = name, float(left)
    return best


def _significance(chi2: float, dof: int, tried: int) -> float:
    return from_chance(min(1.0, float(chdtrc(dof, chi2)) * tried))


def significance(optimum: Posterior, lin: Posterior, jump: Jump) -> float:
    """`Jump.sigmas` by an F test, as a jump may itself have made the noise levels without it small.

    With n residuals that the levels rest on, the score of a jump of m numbers is S at levels with its residuals, and
    chi2 = S / (1 - S / n) at those without. Both show n; S / n has Beta's distribution with m / 2 and (n - m) / 2.

    A part that is off at single stations by more than the levels say, has to jump further by as much.

    Args:
        optimum: the one whose noise levels rest on the residuals of the jump, too.
        lin: the point without them.
        jump: from `again`, at levels without its residuals.
    """
    ((gradient, information),) = _terms(optimum, jump.part, np.array([jump.station]))
    score, dof, _ = _score(gradient, information)
    chi2 = jump.chi2 / scatter(lin, jump)
    if score >= jump.chi2 or not dof:
        return _significance(chi2, jump.dof, jump.tried)
    residuals = 1 / (1 / score - 1 / jump.chi2)
    if residuals <= dof:
        return 0.0
    chance = float(betainc((residuals - dof) / 2, dof / 2, 1 / (1 + chi2 / residuals)))
    return from_chance(min(1.0, chance * jump.tried))


def alike(ranked: Sequence[Jump]) -> list[Jump]:
    """Other jumps that are hardly less probable than the first of `likeliest`."""
    least = _rank(ranked[0].chi2, ranked[0].dof) - _ALIKE
    return [jump for jump in ranked[1:] if _rank(jump.chi2, jump.dof) > least]


def _rank(chi2: float, dof: int) -> float:
    """Minus twice the logarithm of the chance of a chi-squared, far out in the tail."""
    return chi2 - (dof - 2) * math.log(max(chi2, 2.0) / 2) + 2 * math.lgamma(dof / 2)


def _after(lin: Posterior, first: int) -> BoolArray:
    """(N,) stations of the same recording from a station on."""
    log = lin.data.log
    return np.asarray((log == log[first]) & (np.arange(len(log)) >= first))


def likeliest(lin: Posterior, each_side: int = _FEWEST_EACH_SIDE) -> list[Jump]:
    """The most probable jump of each part, the best first, whether or not it is significant.

    Args:
        lin: an optimum.
        each_side: fewest stations before and after it.
    """
    data = lin.data
    logs, starts, stations = np.unique(data.log, return_index=True, return_counts=True)
    # Of two recordings, either may be the one that differs; a shorter one is an outlier.
    differing = starts[stations >= each_side][len(logs) <= 2 :].tolist()
    inside: list[int] = []
    for log in logs:
        mine = np.flatnonzero((data.log == log) & lin.inliers.views)
        inside += mine[each_side : len(mine) - each_side + 1].tolist()
    test, parts, ranked = _Test(lin), dict(_parts(lin)), []
    tried = len(parts) * len(differing + inside)
    for name, part in parts.items():
        # Each recording has a place of the board of its own; and a board keeps its shape meanwhile.
        moments = {"board": inside, SHAPE: differing}.get(name, differing + inside)
        every = max(1, math.ceil(len(moments) / _MOST_MOMENTS))
        best = _best(test, name, part, moments[::every])
        if every > 1 and best is not None:
            best = _best(test, name, part, [at for at in moments if abs(at - best[1].station) < every])
        if best is not None:
            ranked.append(best)
    ranked.sort(key=lambda each: -each[0])
    return [
        replace(jump, tried=tried, sigmas=_significance(jump.chi2, jump.dof, tried)) for _, jump in ranked
    ]


def lasts(lin: Posterior, jump: Jump) -> bool:
    """Whether a jump explains more than a deviation of one station, or leg, next to it does.

    Args:
        lin: the optimum with its residuals.
        jump: from `likeliest` there.
    """
    legs, log = lin.data.legs, lin.data.log
    beside = np.arange(jump.station - _FEWEST_EACH_SIDE, jump.station + _FEWEST_EACH_SIDE)
    beside = np.intersect1d(beside, legs[log[legs[:, 1]] == log[jump.station], 1])
    single = _terms(lin, jump.part, beside, lasting=False)
    return max((_score(*each)[0] for each in single), default=0.0) < jump.chi2


def _best(test: _Test, name: str, part: _Part, moments: Sequence[int]) -> tuple[float, Jump] | None:
    """The most probable moment of a part's jump, and its rank."""
    ranked = []
    for first, (gradient, information) in zip(
        moments, test.terms(part, np.array(moments)) if moments else (), strict=True
    ):
        chi2, dof, value = _score(gradient, information)
        if dof:
            ranked.append((_rank(chi2, dof), Jump(name, first, chi2, dof, 0, 0.0, 0.0, value)))
    return max(ranked, key=lambda each: each[0], default=None)
