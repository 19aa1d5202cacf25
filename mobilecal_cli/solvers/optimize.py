"""Levenberg-Marquardt on the eliminated normal equations."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.linearization import solvable
from mobilecal_cli.likelihood.normal import eliminated
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.model import FloatArray

MOST_STEPS = 250  # of one optimization
#: Of the first trial after one without damping that does not help; less than the least is none.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e-6, 1e6
#: Of the damping: growth after a trial that does not help, so many times faster after each further one; largest fall
#: after one that does.
_GROWTH, _LARGEST_FALL = 4.0, 10.0
_CONVERGED, _NO_CHANGE = 1e-10, 1e-13  # of the cost
_NEAR, _ROUNDING = 1e-4, 1e-12  # 0.01 standard deviations, which the last step removes; and of the cost
#: A trial that promises less (0.03 standard deviations) and does not help is the last: readings between which others
#: are interpolated give the cost kinks along the clocks' offsets.
_KINKED = 1e-3


def proposed(lin: Posterior, damping: float = 0.0) -> tuple[Step, float]:
    """The damped step of all unknowns, and the decrease of the cost that it promises.

    Raises:
        SolveError: a singular matrix.
    """
    priors = lin.priors
    normal = eliminated(lin, damping) if damping else lin.normal
    S = priors.basis.T @ (normal.S + np.diag(priors.weight)) @ priors.basis
    s = priors.basis.T @ (normal.s + priors.gradient(lin.state))
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = 1 / np.sqrt(np.diag(S))
    with solvable():
        along = -unit * np.asarray(cho_solve(cho_factor(S * np.outer(unit, unit)), unit * s))
    return normal.step(priors.basis @ along), normal.gain - float(s @ along)


def to_first_order(lin: Posterior) -> Posterior:
    """The optimum, to first order.

    Raises:
        SolveError: a singular matrix.
    """
    return lin.predicted(proposed(lin)[0])


def lowered(
    lin: Posterior,
    damping: float = 0.0,
    near: float = -math.inf,
    weighted: Callable[[Posterior], Posterior] = lambda lin: lin,
) -> tuple[Posterior, float, float]:
    """One step down.

    Args:
        lin: where to start.
        damping: of the first trial; each further one has more.
        near: decrease of the cost; where an undamped step promises less, it is taken to first order.
        weighted: gives a point with the weights that its cost depends on.

    Returns:
        The point after the first step that lowers the cost, the damping of the next one, and the decrease that was
        promised: 0 at the point itself, where no step helps.

    Raises:
        SolveError: a singular matrix even under the largest damping.
    """
    start, growth = weighted(lin), _GROWTH
    while True:
        promised = math.inf
        try:
            step, promised = proposed(start, damping)
            if damping == 0 and promised <= near:
                return lin.predicted(step), 0.0, promised
            trial = lin.after(step)
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # far off, the cost may overflow: no improvement
                gained = start.cost - weighted(trial).cost
            if gained >= -_NO_CHANGE * start.cost and trial.state.parameters.wheels.separation_m > 0:
                # As much smaller as the promise was kept (Nielsen, 1999).
                kept = min(gained / max(promised, _ROUNDING), 1.0)
                damping *= max(1 / _LARGEST_FALL, 1 - (2 * kept - 1) ** 3)
                return trial, damping if damping > _LEAST_DAMPING else 0.0, promised
        except SolveError:
            if damping > _LARGEST_DAMPING:
                raise
        if damping > _LARGEST_DAMPING or promised < _KINKED:
            return lin, 0.0, 0.0
        damping, growth = damping * growth or _FIRST_DAMPING, growth * _GROWTH


def optimize(
    start: Posterior,
    on_step: Callable[[], None] = lambda: None,
    most_steps: int = MOST_STEPS,
) -> tuple[Posterior, FloatArray]:
    """Minimize the sum of squares of all inliers and priors.

    The legs' covariance stays that of the start; call again from the result to renew it. A start that is off the fixed
    values is moved onto them first. The last step, a short one, is taken to first order.

    Args:
        start: where to start.
        on_step: called before each step.
        most_steps: within which a minimum must be reached.

    Returns:
        The likelihood at the minimum, and (n,) costs from the start on.

    Raises:
        SolveError: no minimum within these steps, or a singular matrix even under the largest damping.
    """
    lin = start
    shift = lin.priors.step_to_mean(lin.state)
    if np.any(shift):
        lin = Posterior.at(lin.state.plus_shared(shift), lin.inliers, lin.noise, lin.priors)
    damping, history = 0.0, [lin.cost]
    for _ in range(most_steps):
        on_step()
        near = _NEAR + _ROUNDING * lin.cost
        lin, damping, promised = lowered(lin, damping, near)
        if promised <= near:
            return lin, np.array(history)
        history.append(lin.cost)
        if damping < _FIRST_DAMPING and history[-2] - lin.cost <= _CONVERGED * history[-2]:
            return lin, np.array(history)
    raise SolveError(
        f"the maximum-likelihood estimate did not converge in {most_steps} steps",
        "check the head chain and the topics, signs and units of joints and wheels in rig.yaml, and that neither the "
        "board nor a cable moved",
    )
