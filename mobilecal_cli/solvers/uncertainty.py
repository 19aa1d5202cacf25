"""Uncertainty of a fit: of the nine parameters, of errors in use, and what limits it."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.budget import usual_jackknife_factor
from mobilecal_cli.likelihood.effects import CameraEffect
from mobilecal_cli.likelihood.nuisance import camera_change
from mobilecal_cli.likelihood.predict import camera_covariance, expected, weights_at
from mobilecal_cli.likelihood.state import cameras_at
from mobilecal_cli.model import NINE, Budget, FloatArray, NoiseLevels, Uncertainty
from mobilecal_cli.solvers.fit import Fit

#: A parameter is observable if its standard deviation is below this share of the prior sigma of a nominal value.
OBSERVABLE_SHARE = 1 / 3
_STEP = 1e-6  # of a constant, rad, m, px or a share, for differences


def uncertainty_of(fit: Fit) -> Uncertainty:
    """Uncertainty of the nine parameters of a fit."""
    jackknife, J = _jackknife_covariance(fit), _reference_jacobian(fit)
    J[fit.lin.priors.fixed[:9]] = 0.0  # exact, whatever the stereo pair is
    widened = _widening(fit, np.sqrt(np.diag(jackknife)[:9]))
    factor = np.ones(len(fit.covariance))
    factor[:9] = widened
    shared = fit.covariance * np.outer(factor, factor)
    covariance = shared[:9, :9]
    scales, fixed = fit.lin.priors.scales[:9], fit.lin.priors.fixed[:9]
    observable = (np.sqrt(np.diag(covariance)) < OBSERVABLE_SHARE * scales) & ~fixed
    shows = _at_work_basis(fit)
    at_work = shows @ shared @ shows
    but_height = np.sqrt(np.diag(at_work)[:9])
    camera, camera_constants = camera_covariance(fit.lin, at_work)
    levels = [name for name in fit.components if name not in fit.given]
    return Uncertainty(
        covariance=covariance,
        reference_covariance=J @ shared @ J.T,
        observable=observable,
        unobservable=fit.lin.priors.unobservable[:, :9],
        scales=scales,
        singular_values=fit.singular_values,
        noise=NoiseLevels(
            **fit.noise.levels,
            wider=fit.noise.wider,
            estimated=tuple(levels),
            redundancy={name: fit.components[name].redundancy for name in levels},
        ),
        fixed=fixed,
        jackknife_std=np.sqrt(np.diag(J @ jackknife @ J.T)),
        noise_std=np.sqrt(np.diag(J @ fit.covariance @ J.T)),
        described=~observable & ~fixed & (but_height < OBSERVABLE_SHARE * scales),
        widened=widened,
        at_work=expected(weights_at(fit.lin), at_work),
        camera=camera,
        camera_constants=camera_constants,
        budget=_budget_of(fit, shows),
    )


def _at_work_basis(fit: Fit) -> FloatArray:
    """(P, P) projection of the shared parameters without the height of a camera that never tilts."""
    shows, vertical = np.eye(fit.data.layout.size), unseen_height(fit.data.chain)
    if vertical is not None:
        shows[3:6, 3:6] -= np.outer(vertical, vertical)
    return shows


def _budget_of(fit: Fit, shows: FloatArray) -> Budget:
    """What limits the accuracy: shares of noise levels, kinds of constants and priors in each variance.

    Args:
        fit: the estimate.
        shows: (P, P) projection of the shared parameters that errors in use depend on.
    """
    lin, layout = fit.lin, fit.data.layout
    kinds = {f"prior {row.name}": row.kind for row in layout.constants}
    kinds |= {f"prior {name}": "nominal" for name in NINE}
    kinds |= {"slip": "wheel_rad_per_sqrt_rad", "free": "other"}
    weights = {name: shows @ W @ shows for name, W in weights_at(lin).items()}
    sources: dict[str, FloatArray] = {}
    for name, share in fit.budget.items():
        source = kinds.get(name, name)
        figures = [np.sum(W * share) for W in weights.values()]
        sources[source] = sources.get(source, 0.0) + np.concatenate([np.diag(share)[:9], figures])
    values = np.array(list(sources.values()))
    total = values.sum(axis=0)
    nine, at_work = np.split(values / np.where(total > 0, total, 1.0), [9], axis=1)
    return Budget(tuple(sources), nine, dict(zip(weights, at_work.T, strict=True)))


def _jackknife_covariance(fit: Fit) -> FloatArray:
    """Jackknife covariance of the nine parameters and the constants, (P, P).

    The units left out in turn are each station's images, its joint readings and each leg's wheels. Each unit's shift
    is weighted by the square root of its redundancy (the weighted jackknife of Wu, Annals of Statistics 14, 1986), so
    that with true noise levels the expected value is the covariance itself. The priors' shares are added: residuals do
    not show them.
    """
    spread = sum(influence.spread for influence in fit.influences)
    C, weight, considered = fit.lin.conditional_covariance, fit.lin.priors.weight, fit.lin.considered
    return np.asarray(spread + (C * weight) @ C.T + considered @ considered.T)


def _reference_jacobian(fit: Fit) -> FloatArray:
    """(9, K) derivative of the nine parameters of the reference camera by those of the first one and the constants."""
    data, state = fit.data, fit.lin.state
    J = np.eye(9, data.layout.size)
    if data.cameras.reference == data.cameras.names[0]:
        return J
    R_h_c, T_c_reference = state.parameters.T_h_c[:3, :3], cameras_at(data, state).T_c_reference
    J[3:6, :3] = -se3.skew(R_h_c @ T_c_reference[:3, 3])
    for k, name, _ in data.layout.of(CameraEffect):
        moved = {**state.constants, name: state.value(name) + _STEP}
        T = camera_change(data.cameras, data.layout.constants, moved).apply(data.cameras).T_c_reference
        turn = se3.log_so3(T[:3, :3] @ T_c_reference[:3, :3].T)
        J[:3, k] = R_h_c @ turn / _STEP
        J[3:6, k] = R_h_c @ (T[:3, 3] - T_c_reference[:3, 3]) / _STEP
    return J


def _widening(fit: Fit, jackknife: FloatArray) -> FloatArray:
    """Factor on the standard deviation of each of the nine parameters, (9,).

    The jackknife's, where it is larger than its own scatter explains: the residuals then vary more than their noise
    levels say, or are not independent.
    """
    std = np.sqrt(np.diag(fit.covariance)[:9])
    ratio = jackknife / np.where(std > 0, std, np.inf)
    usual = usual_jackknife_factor(int(fit.inliers.legs.sum()))
    return np.where(ratio > usual, ratio, 1.0)
