"""Several recordings of one robot: the estimate of each, and the spread between them beyond their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.shared import Layout
from mobilecal_cli.likelihood.system import linearize
from mobilecal_cli.model import NINE, BetweenLogs, FloatArray

_SHOWN = 1.0  # least scale over standard deviation of a direction that is observable in a recording
_SHARE = 0.1  # limit of a parameter's share in the unobservable directions
_CHANCE = 0.01  # significance level of a difference between recordings


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """Combined estimate of several recordings.

    Attributes:
        between: the estimate of each recording, and the spread between them.
        step: (named,) from the optimum of all measurements to the estimate that includes the spread.
        covariance: (named, named) of that estimate.
    """

    between: BetweenLogs
    step: FloatArray
    covariance: FloatArray


def one_log(
    problem: Problem, state: State, selection: Selection, leg_covariance: FloatArray, log: int
) -> tuple[Problem, State, Selection, FloatArray]:
    """The part of a problem, its state, its selection and its leg covariance that belongs to one recording."""
    mine = problem.log == log
    legs = mine[problem.legs[:, 0]]
    number = np.cumsum(mine) - 1
    boards = np.unique(problem.board[mine])
    part = replace(
        problem,
        pixels=problem.pixels[mine],
        seen=problem.seen[mine],
        whitening=problem.whitening[mine],
        joints=problem.joints[mine],
        joint_tracks=problem.joint_tracks[log : log + 1],
        moving=problem.moving[mine],
        joint_sides=problem.joint_sides[mine],
        log=np.zeros(int(mine.sum()), dtype=np.int64),
        board=np.searchsorted(boards, problem.board[mine]),
        legs=number[problem.legs[legs]],
        tracks=problem.tracks[log : log + 1],
        times_ns=problem.times_ns[mine],
        layout=Layout(problem.layout.extras, len(boards)),
    )
    there = replace(
        state,
        T_w_k=state.T_w_k[boards],
        base=state.base[mine],
        joint_errors=state.joint_errors[mine],
        encoder_errors=state.encoder_errors[mine],
    )
    believed = Selection(
        selection.corners[mine], selection.views[mine], selection.legs[legs], selection.readings[mine]
    )
    return part, there, believed, leg_covariance[legs]


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """Estimate of one recording, in scaled units.

    Attributes:
        step, std: (named,) from the common optimum, NaN for unobservable parameters.
        distance: chi-squared distance of the common optimum, with `shown` degrees of freedom.
        shown: number of observable directions.
    """

    step: FloatArray
    std: FloatArray
    distance: float
    shown: int


def _own(A: FloatArray, a: FloatArray, basis: FloatArray) -> _Own:
    values, vectors = np.linalg.eigh(A)
    shown = values > _SHOWN**2
    inverse = np.where(shown, 1 / np.where(shown, values, 1.0), 0.0)
    covariance = (vectors * inverse) @ vectors.T
    step, std = basis @ (-covariance @ a), np.sqrt(np.einsum("nf,fg,ng->n", basis, covariance, basis))
    lost = np.linalg.norm(basis @ vectors[:, ~shown], axis=1) > _SHARE
    return _Own(
        np.where(lost, np.nan, step), np.where(lost, np.nan, std), float(a @ covariance @ a), int(shown.sum())
    )


def between_variance(values: FloatArray, std: FloatArray) -> float:
    """Variance between groups beyond their own (moment estimate of DerSimonian and Laird), from (L,) and (L,)."""
    seen = np.isfinite(values) & (std > 0)
    if seen.sum() < 2:
        return 0.0
    weight = std[seen] ** -2
    mean = np.sum(weight * values[seen]) / weight.sum()
    Q = float(np.sum(weight * (values[seen] - mean) ** 2))
    spare = float(weight.sum() - np.sum(weight**2) / weight.sum())
    return max(0.0, (Q - (int(seen.sum()) - 1)) / spare)


def weigh_logs(
    problem: Problem,
    state: State,
    selection: Selection,
    noise: Noise,
    leg_covariance: FloatArray,
    scales: FloatArray,
    basis: FloatArray,
    prior: FloatArray,
) -> Pooled:
    """Combine the recordings, with the spread between them in their weights.

    The spread is zero if the differences are not significant (a chi-squared test of all nine together). Otherwise each
    recording's information W = (A^-1 + T)^-1 = (I + A T)^-1 A includes the spread T, which limits the weight of a
    recording with many stations.

    Args:
        problem, state, selection, noise, leg_covariance: the optimum of all measurements.
        scales: (named,) units.
        basis: (named, F) free directions, orthonormal in units of `scales`.
        prior: (named,) inverse variances of the priors, which belong to no recording.
    """
    named = problem.layout.named
    parts, logs = [], []
    for log in range(len(problem.tracks)):
        if not (problem.log == log).any():
            continue
        part, there, believed, covariance = one_log(problem, state, selection, leg_covariance, log)
        system = linearize(part, there, believed, noise, covariance)
        S, s = system.S, system.s
        onto = np.linalg.solve(S[named:, named:], np.column_stack([S[named:, :named], s[named:]]))
        reduced = S[:named, :named] - S[:named, named:] @ onto[:, :-1]
        gradient = s[:named] - S[:named, named:] @ onto[:, -1]
        A = basis.T @ (reduced * np.outer(scales, scales)) @ basis
        a = basis.T @ (gradient * scales)
        parts.append((A, a))
        logs.append(_own(A, a, basis))
    own, std = (np.array([getattr(log, name)[: len(NINE)] for log in logs]) for name in ("step", "std"))
    variance = np.zeros(named)
    spare = sum(log.shown for log in logs) - basis.shape[1]
    if spare > 0 and chdtrc(spare, sum(log.distance for log in logs)) < _CHANCE:
        variance[: len(NINE)] = [between_variance(own[:, k], std[:, k]) for k in range(len(NINE))]
    T = basis.T @ (variance[:, None] * basis)
    total = basis.T @ ((prior * scales**2)[:, None] * basis)
    right = np.zeros(basis.shape[1])
    for A, a in parts:
        shrink = np.linalg.inv(np.eye(len(a)) + A @ T)
        total += shrink @ A
        right += shrink @ a
    inverse = np.linalg.inv((total + total.T) / 2)
    step = basis @ (-inverse @ right) if variance.any() else np.zeros(named)
    nine = scales[: len(NINE)]
    between = BetweenLogs((own - step[: len(NINE)]) * nine, std * nine, np.sqrt(variance[: len(NINE)]) * nine)
    return Pooled(between, step * scales, (basis @ inverse @ basis.T) * np.outer(scales, scales))
