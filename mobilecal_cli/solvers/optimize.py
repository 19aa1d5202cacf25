"""Levenberg-Marquardt on the eliminated normal equations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.linearization import solvable
from mobilecal_cli.likelihood.normal import eliminated
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.model.arrays import FloatArray

MOST_STEPS = 250  # tried, of one optimization
#: Of the first step after one without damping that does not help; less than the least is none.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e-6, 1e6
#: Of the damping: growth after a step that does not help, so many times faster after each further one; largest fall
#: after one that does.
_GROWTH, _LARGEST_FALL = 4.0, 10.0
_CONVERGED = 1e-10  # of the cost
_NEAR, _ROUNDING = 1e-4, 1e-12  # 0.01 standard deviations, which the last step removes; and of the cost
_SLOW = 0.05  # 0.2 standard deviations: after the last allowed step, a smaller gain counts as converged
_TINY_GAIN = 1e-3  # 0.03 standard deviations: where a step that promises less does not help, none does


def proposed(lin: Posterior, damping: float = 0.0) -> tuple[Step, float]:
    """The damped step of all unknowns, and the decrease of the cost that it promises.

    Raises:
        SolveError: a singular matrix.
    """
    priors = lin.priors
    normal = eliminated(lin, damping) if damping else lin.normal
    S = priors.reduced(normal.S + np.diag(priors.weight))
    s = priors.onto_free(normal.s + priors.gradient(lin.state))
    with solvable(), np.errstate(invalid="ignore", divide="ignore"):
        unit = 1 / np.sqrt(np.diag(S))
        along = -unit * np.asarray(cho_solve(cho_factor(S * np.outer(unit, unit)), unit * s))
    return normal.step(priors.from_free(along)), normal.gain - float(s @ along)


def to_first_order(lin: Posterior) -> Posterior:
    """The optimum, to first order.

    Raises:
        SolveError: a singular matrix.
    """
    return lin.extrapolated(proposed(lin)[0])


def optimize(
    start: Posterior,
    on_step: Callable[[], None] = lambda: None,
    most_steps: int = MOST_STEPS,
) -> tuple[Posterior, FloatArray]:
    """Minimize the sum of squares of all inliers and priors.

    The legs' covariance stays that of the start; call again from the result to renew it. A start that is off the fixed
    values is moved onto them first. A trial that leads to a singular matrix counts as a step that does not help. The
    last step, a short one, is taken to first order.

    Args:
        start: where to start.
        on_step: called before each step.
        most_steps: tried, within which a minimum must be reached.

    Returns:
        The likelihood at the minimum, and (n,) costs from the start on.

    Raises:
        SolveError: no minimum within these steps, or a singular matrix even under the largest damping.
    """
    lin = start
    shift = lin.priors.step_to_mean(lin.state)
    if np.any(shift):
        lin = Posterior.at(lin.state.plus_shared(shift), lin.inliers, lin.noise, lin.priors)
    damping, growth, history, converged = 0.0, _GROWTH, [lin.cost], False
    for trials in range(most_steps + 1):
        on_step()
        try:
            step, gain = proposed(lin, damping)
        except SolveError:
            damping, growth = damping * growth or _FIRST_DAMPING, growth * _GROWTH
            if damping > _LARGEST_DAMPING:
                raise
            continue
        if converged or (damping == 0 and gain <= _NEAR + _ROUNDING * lin.cost):
            return lin if converged else lin.extrapolated(step), np.array(history)
        trial = lin.after(step)
        before = lin.cost
        with np.errstate(over="ignore", invalid="ignore"):  # far off, the cost may overflow: no improvement
            better = trial.cost <= before * (1 + 1e-13)
        if better and trial.state.parameters.wheels.separation_m > 0:
            converged = before - trial.cost <= _CONVERGED * before + 1e-14 and damping < 1e-3
            lin = trial
            history.append(lin.cost)
            converged |= trials + 1 == most_steps and history[-2] - lin.cost < _SLOW
            # As much smaller as the promise was kept (Nielsen, 1999).
            kept = min((history[-2] - lin.cost) / max(gain, _ROUNDING), 1.0)
            damping *= max(1 / _LARGEST_FALL, 1 - (2 * kept - 1) ** 3)
            damping, growth = 0.0 if damping < _LEAST_DAMPING or converged else damping, _GROWTH
        else:
            damping, growth = damping * growth or _FIRST_DAMPING, growth * _GROWTH
            if damping > _LARGEST_DAMPING or gain < _TINY_GAIN:
                converged, damping = True, 0.0  # no step helps any more: the minimum, to rounding
                history.append(lin.cost)
    raise SolveError(
        f"the maximum-likelihood estimate did not converge in {most_steps} steps",
        "check the head chain and the topics, signs and units of joints and wheels in rig.yaml, and that neither the "
        "board nor a cable moved",
    )
