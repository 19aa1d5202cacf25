"""Findings of a fit for the report: evidence, scale check, jackknife, spread between recordings, suggestions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.likelihood.between import weigh_logs
from mobilecal_cli.likelihood.evidence import evidence
from mobilecal_cli.likelihood.problem import moved
from mobilecal_cli.likelihood.suggest import suggestions
from mobilecal_cli.model import Evidence, Extraction, FloatArray, ScaleCheck, Suggestion
from mobilecal_cli.solvers.fit import Fit

_APART_CHI2 = 16.0  # scales that differ by more than four sigma are inconsistent


def evidence_of(fit: Fit) -> tuple[Evidence, ...]:
    """Evidence for every group of additional parameters."""
    optimum = fit.optimum
    prior, _, _ = fit.ties.prior_terms(fit.problem, optimum.state)
    found = evidence(
        fit.problem, optimum.state, fit.selection, fit.noise, optimum.leg_covariance, prior, optimum.basis
    )
    return tuple(found)


def scale_of(extraction: Extraction, found: tuple[Evidence, ...]) -> ScaleCheck | None:
    """Consistency of square size and stereo baseline; None if no square size is stated or it is unobservable."""
    square_m = extraction.board.square_m
    ratio = next((e for e in found if e.group == "square_scale" and e.state != "hidden"), None)
    if square_m is None or ratio is None:
        return None
    value, std = ratio.values["square_scale"]
    return ScaleCheck(1 + value, std, square_m, extraction.rig.cameras.baseline_m, ratio.chi2 > _APART_CHI2)


def jackknife_std(fit: Fit) -> FloatArray:
    """Jackknife standard deviations of the nine parameters, (9,), rad and m.

    The units left out in turn are each station's images, its joint readings and each leg's wheels. Each unit's shift
    is weighted by the square root of its redundancy (the weighted jackknife of Wu, Annals of Statistics 14, 1986), so
    that with true noise levels the expected value is the covariance itself.
    """
    spread = sum(np.diag(influence.spread)[:9] for influence in fit.influences())
    return np.asarray(np.sqrt(spread))


def over_logs(fit: Fit) -> Fit:
    """The fit with the spread between recordings included; unchanged for a single recording."""
    problem, state = fit.problem, fit.optimum.state
    if len(np.unique(problem.log)) < 2:
        return fit
    prior, _, _ = fit.ties.prior_terms(problem, state)
    named = problem.layout.named
    pooled = weigh_logs(
        problem,
        state,
        fit.selection,
        fit.noise,
        fit.optimum.leg_covariance,
        fit.ties.scales,
        fit.ties.named_basis(),
        prior[:named],
    )
    if np.any(pooled.step):
        S = fit.optimum.system.S
        boards = -np.linalg.solve(S[named:, named:], S[named:, :named] @ pooled.step)
        step = np.concatenate([pooled.step, boards])
        state = moved(problem, state, step, *fit.optimum.system.back(step))
    return replace(
        fit, optimum=replace(fit.optimum, state=state), between=pooled.between, over_logs=pooled.covariance
    )


def suggestions_of(fit: Fit) -> tuple[Suggestion, ...]:
    """Suggested next stops."""
    return suggestions(
        fit.problem,
        fit.optimum.state,
        fit.noise,
        fit.optimum.system,
        fit.covariance,
        fit.held,
        fit.ties.scales,
    )
