"""Findings of a fit for the report: scale check, jackknife, spread between recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.likelihood.between import weigh_logs
from mobilecal_cli.model import Evidence, Extraction, FloatArray, ScaleCheck
from mobilecal_cli.solvers.fit import Fit

_APART_CHI2 = 16.0  # scales that differ by more than four sigma are inconsistent


def scale_of(extraction: Extraction, found: tuple[Evidence, ...]) -> ScaleCheck | None:
    """Consistency of square size and stereo baseline; None if no square size is stated or it is unobservable."""
    square_m = extraction.board.square_m
    ratio = next((e for e in found if e.group == "square_scale" and e.state != "unobservable"), None)
    if square_m is None or ratio is None:
        return None
    value, std = ratio.values["square_scale"]
    return ScaleCheck(1 + value, std, square_m, extraction.rig.cameras.baseline_m, ratio.chi2 > _APART_CHI2)


def jackknife_std(fit: Fit) -> FloatArray:
    """Jackknife standard deviations of the nine parameters, (9,), rad and m.

    The units left out in turn are each station's images, its joint readings and each leg's wheels. Each unit's shift
    is weighted by the square root of its redundancy (the weighted jackknife of Wu, Annals of Statistics 14, 1986), so
    that with true noise levels the expected value is the covariance itself. The prior variance of unobservable
    directions is added: residuals do not show it.
    """
    spread = sum(np.diag(influence.spread)[:9] for influence in fit.lin.influences)
    return np.asarray(np.sqrt(spread + np.sum(fit.lin.considered[:9] ** 2, axis=1)))


def over_logs(fit: Fit) -> Fit:
    """The fit with the spread between recordings included; unchanged for a single recording."""
    lin = fit.lin
    if len(np.unique(lin.data.log)) < 2:
        return fit
    pooled = weigh_logs(lin)
    if np.any(pooled.step):
        named, S = lin.data.layout.named, lin.normal.S
        boards = -np.linalg.solve(S[named:, named:], S[named:, :named] @ pooled.step)
        lin = lin.after(lin.normal.step(np.concatenate([pooled.step, boards])))
    return replace(fit, lin=lin, between=pooled.between, pooled_covariance=pooled.covariance)
