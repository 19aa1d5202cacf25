"""Evidence for additional parameters: Rao's score test, from one linearization."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.shared import EXTRA_NAMES, EXTRAS, INDEX
from mobilecal_cli.likelihood.system import linearize
from mobilecal_cli.model import Evidence, FloatArray


def _offered(problem: Problem) -> tuple[str, ...]:
    """Additional parameters that can be observable in this problem."""
    joints = problem.chain.joints
    unusable = set()
    if not problem.moving.any() or not problem.joint_tracks:
        unusable |= {"time_joints", "time_wheels"}
    for role, names in (
        (problem.chain.pan, ("pan_zero", "backlash_pan")),
        (problem.chain.tilt, ("backlash_tilt",)),
    ):
        sides = problem.joint_sides[:, joints.index(role)] if role in joints else np.zeros(1)
        unusable |= {n for n in names if role not in joints or (n != "pan_zero" and not np.ptp(sides))}
    return tuple(name for name in EXTRA_NAMES if name not in unusable)


def measurements(problem: Problem, selection: Selection) -> int:
    """Number of inlier measurements."""
    corners = selection.corners & selection.views[:, None, None]
    return 2 * int(corners.sum()) + 3 * int(selection.legs.sum()) + int(selection.readings.sum())


def evidence(
    problem: Problem,
    state: State,
    selection: Selection,
    noise: Noise,
    leg_covariance: FloatArray,
    prior: FloatArray,
    basis: FloatArray,
) -> Iterator[Evidence]:
    """Evidence for every group of additional parameters at an optimum, tested one group at a time.

    Args:
        problem, state, selection, noise, leg_covariance: the optimum.
        prior: (P,) information of the priors, on the diagonal.
        basis: (P, F) free directions of the optimum.
    """
    offered = _offered(problem)
    layout = problem.layout
    whole = problem.with_extras(tuple(n for n in EXTRA_NAMES if n in (*layout.extras, *offered)))
    system = linearize(whole, state, selection, noise, leg_covariance)
    named = whole.layout.names
    old = [named.index(name) for name in layout.names]
    old += list(range(whole.layout.named, whole.layout.size))
    A = np.zeros((whole.layout.size, basis.shape[1]))
    A[old] = basis
    information = system.S.copy()
    information[old, old] += prior
    price = math.log(measurements(problem, selection))
    for group in dict.fromkeys(extra.group for extra in EXTRAS):
        members = [extra.name for extra in EXTRAS if extra.group == group]
        free = [name for name in members if name in layout.extras]
        names = free or [name for name in members if name in offered]
        if not names:
            continue
        yield _group(group, names, bool(free), state, named, information, system.s, A, price)


def _group(
    group: str,
    names: list[str],
    estimated: bool,
    state: State,
    named: tuple[str, ...],
    information: FloatArray,
    gradient: FloatArray,
    A: FloatArray,
    price: float,
) -> Evidence:
    columns = [named.index(name) for name in names]
    scales = np.array([EXTRAS[INDEX[name]].scale for name in names])
    rest = A[:, ~np.any(A[columns] != 0, axis=0)]
    unit = 1 / np.sqrt(np.einsum("pf,pq,qf->f", rest, information, rest))
    inner = unit[:, None] * (rest.T @ information @ rest) * unit
    across = (rest.T @ information[:, columns]) * unit[:, None] * scales
    own = information[np.ix_(columns, columns)] * np.outer(scales, scales)
    schur = own - across.T @ np.linalg.solve(inner, across)
    values, vectors = np.linalg.eigh(schur)
    if values[0] < 1.0:  # the standard deviation exceeds the scale in some direction
        return Evidence(group, dict.fromkeys(names, (0.0, math.inf)), "hidden", 0.0, 0.0)
    covariance = (vectors / values) @ vectors.T
    if estimated:
        found = np.array([state.extra(name) for name in names]) / scales
    else:
        found = -covariance @ (gradient[columns] * scales)
    chi2 = float(found @ schur @ found)
    std = np.sqrt(np.diag(covariance)) * scales
    known = {n: (float(v), float(s)) for n, v, s in zip(names, found * scales, std, strict=True)}
    return Evidence(group, known, "estimated" if estimated else "offered", chi2, chi2 - len(names) * price)
