"""Solve an extraction for the nine parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from mobilecal_cli.errors import ConfigError, SolveError
from mobilecal_cli.kinematics import FEWEST_LEGS, encoder_steps_rad, integrate
from mobilecal_cli.likelihood.constants import PATTERNS
from mobilecal_cli.likelihood.dataset import Dataset, Inliers, dataset_of
from mobilecal_cli.likelihood.effects import Rolling
from mobilecal_cli.likelihood.evidence import equivalent_sigmas, evidence
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.processes import path_m
from mobilecal_cli.likelihood.suggest import suggestions
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.findings import (
    CONTRADICTION_SIGMAS,
    MATERIAL_SIGMAS,
    STAMP_NOISE_S,
    WHEEL_NOISE,
    Diagnosis,
)
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import (
    ErrorPart,
    LinearEstimate,
    Method,
    Refinement,
    Residuals,
    Solution,
    largest_mean_square,
)
from mobilecal_cli.ranges import of_parameter
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.findings import (
    constants_of,
    contradictions_of,
    jumps_of,
    outliers_of,
    pool_recordings,
    scale_of,
    wrong_headings,
)
from mobilecal_cli.solvers.fit import LikelihoodFit, uncertainty_of
from mobilecal_cli.solvers.inference import Inference, dataset_for
from mobilecal_cli.solvers.initial import CLEARLY_BETTER, linear_estimate, linear_with_prior, start_state
from mobilecal_cli.solvers.linear import ratios_of
from mobilecal_cli.solvers.maximum_likelihood import FIRST_STEPS, robust_fit
from mobilecal_cli.solvers.optimize import optimize
from mobilecal_cli.solvers.residuals import (
    at_state,
    error_parts,
    images_alike,
    leg_squares,
    residuals_of,
)
from mobilecal_cli.solvers.search import FITS, Search, other_wheels, turned_around
from mobilecal_cli.solvers.transfer import leg_rms_m, point_rms_m, refine_lm, refine_powell

# A mistake is searched for where the point error, without the noise of the corners, is more than this share of the
# distance to the board and than the steps of the encoders make it, or where more than this share of the stations of a
# recording have an outlier.
_BAD_SHARE, _MANY_OUTLIERS = 0.015, 0.3
# Rms of the patterns of lenses and board over their priors, beyond which they are no patterns.
_LENS_SIGMAS = 3.0
# It is searched for before the estimate where the point error of the linear method is more than the first share of the
# distance; no robust estimate helps where that of most stations is more than the second.
_GROSS_SHARE, _HOPELESS_SHARE = 0.1, 0.2
_MOST_OF_WHEEL = 0.5  # of its radius: no tire changes by so much


def solve(
    extraction: Extraction,
    method: Method = "ml",
    constraints: Constraints | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Solution:
    """Solution for all nine parameters.

    Args:
        extraction: at least three legs; for all methods but "ml", the motion must make all nine parameters
            observable (see `uncertainty`).
        method: "ml" (maximum likelihood), "linear" (paper, section 3.5), "paper" (eq. 19 by Powell) or "lm"
            (eq. 19 by Levenberg-Marquardt).

        constraints: fixed parameters, priors and additional parameters, for "ml" only.
        on_step: called before each optimization step, for "ml" only.

    Raises:
        ConfigError: a constraint that this robot or recording cannot have.
        SolveError: fewer than three legs, did not converge, an encoder has the wrong sign, the wheels are swapped,
            or an unobservable parameter has no nominal value.
    """
    try:
        return _solved(extraction, method, constraints or Constraints(), on_step)
    except SolveError as error:
        message, hint = extraction.worded(error.message), extraction.worded(error.cure)
        raise SolveError(message, hint, error.explained, error.noted) from error.__cause__
    except ConfigError as error:
        raise ConfigError(extraction.worded(error.message), extraction.worded(error.hint)) from error


def _solved(
    extraction: Extraction, method: Method, constraints: Constraints, on_step: Callable[[], None]
) -> Solution:
    """The same, in words of a recording and rig.yaml.

    Raises:
        ConfigError, SolveError: see `solve`.
    """
    rig = extraction.rig
    stated = {"priors in rig.yaml": rig.prior_sigmas, "noise in rig.yaml": rig.noise}
    asked = (*constraints.given, *(where for where, values in stated.items() if values))
    if extraction.motions:
        constraints = constraints.of_planar_sensor()
    if extraction.legs < FEWEST_LEGS:
        raise SolveError(
            f"{len(extraction.observations)} stations with {extraction.legs} legs between them "
            f"(at least {FEWEST_LEGS} legs needed)",
            "record more stations in each recording",
        )
    search = Search(extraction)
    try:
        if method == "ml":
            inference = Inference.of(extraction, constraints, on_step)
            layout = inference.data.layout
            constraints.check_shown({*layout.names, *(row.kind for row in layout.constants)})
            solution = _by_likelihood(extraction, inference, search)
        else:
            solution = _by_points(extraction, method)
    except (SolveError, np.linalg.LinAlgError) as error:
        refusal = _refusal(extraction, search)
        if refusal is None and isinstance(error, SolveError):
            if not asked:
                raise
            # What the user asks for may be the cause.
            hint = f"leave out or correct {', '.join(asked)}; or {error.hint}"
            raise SolveError(error.message, hint) from error.__cause__
        raise refusal or SolveError(
            "the measurements do not determine all parameters",
            "record more stations, with the whole board in the images",
        ) from error
    diagnosis = _diagnosis(solution, extraction, search)
    if diagnosis is not None:
        cause, cure = extraction.worded(diagnosis.cause), extraction.worded(diagnosis.cure)
        diagnosis = replace(diagnosis, cause=cause, cure=cure)
    return replace(solution, diagnosis=diagnosis)


def _by_likelihood(extraction: Extraction, inference: Inference, search: Search) -> Solution:
    linear, refusal = _linear_start(extraction, inference, search)
    fit = robust_fit(inference, linear.parameters)
    # These are of the fit as it is: pooling several recordings moves the estimate.
    jump = inference.jump(fit)
    jumps = jumps_of(extraction, fit, jump)
    still = fit if jump is None or jump.shift_sigmas < MATERIAL_SIGMAS else inference.beside(fit, jump)
    contradictions = contradictions_of(still)
    late = {each.part for each in contradictions if each.late_camera}
    jumps = tuple(each for each in jumps if each.part not in late)
    scale = scale_of(extraction, still, contradictions)
    suggested = suggestions(fit.lin, fit.covariance)
    fit = pool_recordings(fit)
    data, parameters = fit.data, fit.lin.state.parameters
    _require_possible(parameters.wheels)
    legs = fit.sure_legs if fit.sure_legs.any() else None
    used = legs, data.seen & ~fit.inliers.corners
    together = images_alike(fit.lin)
    corrected = at_state(together, fit.noise, corners=fit.inliers.corners)
    rms = point_rms_m(corrected.pairs, parameters)
    history = np.array([linear.point_rms_m, rms])
    refinement = Refinement("ml", parameters, history, rms, len(fit.costs))
    solution = _solution(extraction, corrected, linear, refinement, *used)
    squares = leg_squares(fit.lin, corrected, solution.residuals)
    parts, leg_noise = error_parts(squares), np.sqrt(sum(squares.values()))
    if any(row.kind in PATTERNS for row in data.layout.constants):
        undone = at_state(together, fit.noise, patterns=True, T_c_k=corrected.T_c_k)
        parts["lenses"] = _explained(solution, residuals_of(undone, parameters, *used), _usual_lenses(fit))
    if any(together.present(Rolling)):
        even = replace(corrected, driven=together.evened(corrected.driven))
        parts["turns"] = _explained(solution, residuals_of(even, parameters, *used))
    solution = replace(
        solution, outliers=outliers_of(extraction, fit), error_parts=parts, leg_noise=leg_noise
    )
    if refusal is not None and _fits_badly(solution, extraction):
        raise refusal
    return replace(
        solution,
        uncertainty=replace(
            uncertainty_of(fit),
            asked=_asked_of(extraction, fit, inference, linear.parameters),
            with_prior=np.isin(NINE, list(inference.constraints.priors)),
        ),
        noisy=fit.noisy,
        constants=constants_of(fit),
        evidence=evidence(fit.lin),
        contradictions=contradictions,
        scale=scale,
        between=fit.between,
        jumps=jumps,
        suggestions=suggested,
        diagnosis=wrong_headings(fit) if extraction.motions else None,
    )


def _explained(solution: Solution, without: Residuals, share: float = 1.0) -> ErrorPart:
    """What an error of the robot contributes: residuals `without` it are so much less. A share of its square."""
    squares = [
        float(np.mean(getattr(solution.residuals, name) ** 2 - getattr(without, name) ** 2))
        for name in ("leg_reprojection_px", "leg_point_rms_m")
    ]
    return ErrorPart(*(math.sqrt(share * max(square, 0.0)) for square in squares))


def _usual_lenses(fit: LikelihoodFit) -> float:
    """The share that is usual of what the lenses do beside their models, as a mean square.

    A few tenths of a pixel there are centimeters of a point's depth. If it is more, the description of the cameras is
    wrong.
    """
    patterns = [row for row in fit.data.layout.constants if row.kind in PATTERNS]
    square = float(np.mean([(fit.lin.state.value(row.name) / row.sigma) ** 2 for row in patterns]))
    return min(1.0, _LENS_SIGMAS**2 / max(square, 1.0))


def _linear_start(
    extraction: Extraction, inference: Inference, search: Search
) -> tuple[LinearEstimate, SolveError | None]:
    """The linear estimate, or one near the nominal values where the linear method cannot tell.

    That is where the motion does not show all parameters, or shows a separation or radius so little that its sign is
    noise; and where the stated cameras show the board so wrongly that nothing fits: the likelihood estimates them, too.

    Returns:
        The start, and the refusal of a recording that the likelihood does not fit from there, either.

    Raises:
        SolveError: a mistake in all readings, or a negative radius or separation.
    """
    pairs, full = inference.data.pairs, inference.full_motion
    nominal = extraction.rig.nominal.wheels
    linear = linear_estimate(pairs, nominal) if full else _near_nominal(inference)
    if full and not linear.parameters.wheels.positive and nominal is not None:
        near = _near_nominal(inference)
        # Of most legs: one with a gross error decides on the mean.
        each_m = [float(np.median(leg_rms_m(pairs, each.parameters))) for each in (linear, near)]
        if near.parameters.wheels.positive and each_m[0] >= CLEARLY_BETTER * each_m[1]:
            linear = near
    distance_m = extraction.board_distance_m
    # Another unit of the wheels. Wider priors of squares and baseline would explain it, too, and nominal values pull.
    other = None if full else search.carried or search.other_wheels
    if full and linear.point_rms_m < _BAD_SHARE * distance_m:
        other = other_wheels(linear.parameters.wheels, nominal)
    if other is not None:
        raise _refused(other)
    refusal = None
    if extraction.motions or linear.point_rms_m > _GROSS_SHARE * distance_m:
        unexplained = search.misfit is not None and search.misfit > _HOPELESS_SHARE
        if search.of_whole is not None or (unexplained and search.diagnosis is None):
            refusal = _refusal(extraction, search)
    if refusal is not None:
        near = _near_nominal(inference)
        known = search.diagnosis is not None or search.interrupted is not None
        if known or not _converges(extraction, inference, near.parameters):
            raise refusal
        linear = near
    if full:  # an unobservable scale may have any sign
        _require_positive(linear.parameters.wheels)
    return linear, refusal


def _near_nominal(inference: Inference) -> LinearEstimate:
    pairs = inference.data.pairs
    start = linear_with_prior(pairs, inference.nominal, inference.motion)
    return LinearEstimate(
        start, (start,), 1, point_rms_m(pairs, start), ratios_of(start.wheels), "nominal", math.inf
    )


def _converges(extraction: Extraction, inference: Inference, start: Parameters) -> bool:
    """Whether one fit of all measurements, with the cameras' errors, brings most legs below the gross misfit."""
    data, everything = inference.data, Inliers.all_of(inference.data)
    state = start_state(data, start, everything)
    noise = inference.first_noise(np.array([data.claimed_px]))
    first = Posterior.at(state, everything, noise, inference.priors(state))
    try:
        state = optimize(first, on_step=inference.on_step, most_steps=FIRST_STEPS)[0].state
    except SolveError:
        return False
    each_m = leg_rms_m(at_state(state).pairs, state.parameters)
    return float(np.median(each_m)) < _HOPELESS_SHARE * extraction.board_distance_m


def _by_points(extraction: Extraction, method: Literal["linear", "paper", "lm"]) -> Solution:
    data = dataset_of(extraction)
    pairs = data.pairs
    linear = linear_estimate(pairs, extraction.rig.nominal.wheels)
    _require_positive(linear.parameters.wheels)
    refine = {"linear": None, "paper": refine_powell, "lm": refine_lm}[method]
    return _solution(extraction, data, linear, refine and refine(pairs, linear.parameters))


def _solution(
    extraction: Extraction,
    shown: Dataset,
    linear: LinearEstimate,
    refinement: Refinement | None,
    inliers: BoolArray | None = None,
    rejected: BoolArray | None = None,
) -> Solution:
    parameters = (refinement or linear).parameters
    residuals = residuals_of(shown, parameters, inliers, rejected)
    wheels = parameters.wheels
    psi = integrate(shown.driven, wheels).psi_rad
    return Solution(
        method="linear" if refinement is None else refinement.method,
        parameters=parameters,
        cameras=shown.cameras,
        linear=linear,
        refinement=refinement,
        residuals=residuals,
        point_rms_m=math.sqrt(float(np.mean(residuals.leg_point_rms_m**2))),
        reprojection_rms_px=math.sqrt(float(np.mean(residuals.leg_reprojection_px**2))),
        motion=_motion(extraction, psi, float(path_m(shown.driven, wheels).sum())),
    )


def _motion(extraction: Extraction, psi_rad: FloatArray, driven_m: float) -> dict[str, float]:
    chain = extraction.rig.chain
    joints = np.degrees(np.stack([o.joints for o in extraction.observations]))
    ranges = dict(zip(chain.joints, np.ptp(joints, axis=0), strict=True))
    motion = {
        f"{role}_range_deg": float(ranges[name])
        for role, name in (("pan", chain.pan), ("tilt", chain.tilt))
        if name in ranges and name not in chain.prismatic
    }
    return {
        **motion,
        "turned_deg": float(np.degrees(np.sum(np.abs(psi_rad)))),
        "largest_turn_deg": float(np.degrees(np.max(np.abs(psi_rad)))),
        "driven_m": driven_m,
    }


def _require_positive(wheels: WheelGeometry) -> None:
    """Refuse impossible wheels.

    Raises:
        SolveError: a negative radius or separation.
    """
    if not wheels.positive:
        raise _impossible(wheels, "a negative value")


def _require_possible(wheels: WheelGeometry) -> None:
    """Refuse impossible wheels of a result.

    Raises:
        SolveError: a radius or a separation out of its range.
    """
    _require_positive(wheels)
    for name, size in zip(NINE[6:], wheels.vector.tolist(), strict=True):
        if size not in (possible := of_parameter(name)):
            raise _impossible(wheels, f"a value beyond {possible}")


def _impossible(wheels: WheelGeometry, what: str) -> SolveError:
    right, left, separation = 1e3 * wheels.vector
    return SolveError(
        f"the wheel radii that fit best are {right:.1f} mm (right) and {left:.1f} mm (left), the wheel separation is "
        f"{separation:.1f} mm: {what} is impossible",
        "check the topics, signs and units of the wheels and of the head joints in rig.yaml, and their clocks",
    )


def _refusal(extraction: Extraction, search: Search) -> SolveError | None:
    """The mistake because of which a recording cannot be solved, or how badly it fits; None if neither is known."""
    diagnosis, share = search.diagnosis or search.interrupted, search.misfit
    if diagnosis is not None:
        return _refused(diagnosis)
    if share is None:
        return None
    if extraction.motions:
        return SolveError(
            "the motions do not fit the wheels, and no known mistake explains it: they differ by "
            f"{1e3 * share * extraction.board_distance_m:.0f} mm on most legs. Tried: units, signs, order, frames and "
            "times of the motions; signs, sides and unit of the wheels",
            "check that motions and rotations of the wheels are of the same legs, between the same times, and T_v_c",
        )
    apart_px = float(np.median([o.reprojection_px for o in extraction.observations]))
    of_images = f", the reprojection error is {apart_px:.2g} px (usual: 0.3 px)"
    measured = extraction.measured
    return SolveError(
        "the recording does not fit the robot's description, and no known mistake explains it: the point error is "
        f"{100 * share:.0f} % of the distance to the board at most stations (usual: below {100 * FITS:.0f} %)"
        f"{'' if measured else of_images}. Tried: signs, sides, order and units of joints and wheels, also two at "
        "once; late images, joints or wheels, if the robot stops; readings that stop, jump or change their scale; and "
        "readings of one joint or of the wheels that do not belong to the recording",
        f"check that all {'poses and readings' if measured else 'topics'} belong to this drive and this robot, "
        f"{'' if measured else 'camera_info, '}the head chain, and that neither the board nor a cable moved",
        noted=extraction.first_notes,
    )


def _refused(diagnosis: Diagnosis) -> SolveError:
    message = f"the recording does not fit the robot's description: {diagnosis.cause}"
    return SolveError(message, diagnosis.cure, explained=True)


def _fits_badly(solution: Solution, extraction: Extraction) -> bool:
    """Whether known noise does not explain the point error, or many stations of a recording have an outlier.

    Known are that of corners, what lenses do beside their models, turns that differ, the steps of the encoders, and the
    estimated noise of wheels and of stamps: its largest mean square, but at most what noise at its limit causes.
    """
    stations = Counter(o.log for o in extraction.observations)
    gross = Counter(outlier.log for outlier in solution.gross_outliers)
    distance_m = extraction.board_distance_m
    of_corners_m = min(solution.residuals.corner_noise_m, _GROSS_SHARE * distance_m)  # more is no noise
    right_m, left_m = encoder_steps_rad(extraction.wheels) * solution.parameters.wheels.vector[:2]
    # Heading by one step of each wheel.
    step_rad = float(right_m + left_m) / solution.parameters.wheels.separation_m
    error_m = max(_BAD_SHARE, step_rad) * distance_m
    of_noise, parts = 0.0, solution.error_parts
    of_robot = sum(parts[name].m ** 2 for name in ("lenses", "turns") if name in parts)
    if solution.uncertainty is not None:
        noise, most = solution.uncertainty.noise, largest_mean_square(len(solution.residuals.legs))
        limits = {
            "wheels": WHEEL_NOISE / noise.wheel_rad_per_sqrt_rad,
            "stamps": STAMP_NOISE_S / noise.stamp_s,
        }
        of_noise = sum(
            parts[name].m ** 2 * min(most, limits[name] ** 2) for name in limits.keys() & parts.keys()
        )
    explained = of_corners_m**2 + of_robot + of_noise
    misfits = solution.point_rms_m**2 - explained > error_m**2
    return misfits or any(bad > _MANY_OUTLIERS * stations[log] for log, bad in gross.items())


def _diagnosis(solution: Solution, extraction: Extraction, search: Search) -> Diagnosis | None:
    """The mistake in the description or in the readings in spite of which there is a solution.

    A jump inside a recording that explains the misfit leaves no other mistake of a part of the readings to be searched
    for, unless a wheel changes by more than any does. Where the part that changed is not known, a reading may have
    stopped. A recording that differs from the others may have a mistake of its own.
    """
    log = [o.log for o in extraction.observations]
    largest_m = _MOST_OF_WHEEL * solution.parameters.wheels.vector[:2].min()
    parts = [
        jump.part
        for jump in solution.jumps
        if jump.shift_sigmas >= MATERIAL_SIGMAS
        and jump.station != log.index(jump.log)
        and not ("wheel" in jump.part and abs(jump.move_m) > largest_m)
    ]
    if not extraction.motions:  # of which the search is before the estimate
        if "" in parts and search.interrupted is not None:
            return search.interrupted
        if _fits_badly(solution, extraction):
            return search.of_whole or search.frozen if any(parts) else search.diagnosis
    around = turned_around(extraction.rig, solution.parameters.T_h_c, extraction.measured)
    return around or solution.diagnosis


def _narrower_priors(extraction: Extraction, constraints: Constraints) -> dict[str, tuple[float, list[str]]]:
    """Name or kind of the priors in rig.yaml that are narrower than usual → sigma, and names of the constants."""
    stated = extraction.rig.prior_sigmas
    own = {key: sigma for key, sigma in stated.items() if key != "all"}
    if not own:
        return {}
    others = {key: sigma for key, sigma in stated.items() if key not in own}
    usual = dataset_for(
        replace(extraction, rig=replace(extraction.rig, prior_sigmas=others)), constraints
    ).layout
    given = {*constraints.fixed, *constraints.priors}
    narrow = {
        key: [
            row.name
            for row in usual.constants
            if key in (row.name, row.kind) and sigma < row.sigma and row.name not in given
        ]
        for key, sigma in own.items()
    }
    return {key: (own[key], names) for key, names in narrow.items() if names}


def _asked_of(
    extraction: Extraction, fit: LikelihoodFit, inference: Inference, start: Parameters
) -> dict[tuple[str, ...], tuple[float, float]]:
    """How far the data alone are from what the user asks, each and all together, see `Uncertainty.asked`.

    Empty where the data alone do not determine the parameters, and for a planar sensor, much of which is fixed always.
    """
    constraints, priors, known = inference.constraints, fit.lin.priors, fit.data.layout.names
    given = {
        option: (
            constraints.priors.get(names[0], (0.0, 0.0))[1],
            {name: float(priors.mean[known.index(name)]) for name in names if name in known},
        )
        for option, names in constraints.given.items()
        if not {*names} & {*constraints.constants}
    }
    narrow = _narrower_priors(extraction, constraints)
    given |= {f"priors.{key}": (sigma, dict.fromkeys(names, 0.0)) for key, (sigma, names) in narrow.items()}
    if not given or extraction.motions:
        return {}
    usual = {key: sigma for key, sigma in extraction.rig.prior_sigmas.items() if key not in narrow}
    freed = replace(extraction, rig=replace(extraction.rig, prior_sigmas=usual))
    asked = [name for _, means in given.values() for name in means]
    try:
        alone = robust_fit(Inference.of(freed, constraints.without(asked), inference.on_step), start)
    except SolveError:
        return {}
    layout = alone.data.layout
    shown = {
        option: (sigma, {name: mean for name, mean in means.items() if name in layout.names})
        for option, (sigma, means) in given.items()
    }
    given = {option: each for option, each in shown.items() if each[1]}
    nine, used = (each.lin.state.parameters.minus(priors.anchor) for each in (alone, fit))
    std = np.sqrt(np.diag(alone.covariance)[: len(NINE)])
    shift = float(np.max(np.abs(nine - used) / std))
    values = np.append(nine, [alone.lin.state.value(row.name) for row in layout.constants])

    def sigmas(*options: str) -> float:
        means = [(given[each][0], *item) for each in options for item in given[each][1].items()]
        own, names, mean = (list(column) for column in zip(*means, strict=True))
        at = [layout.names.index(name) for name in names]
        away = values[at] - mean
        spread = alone.covariance[np.ix_(at, at)] + np.diag(np.square(own))
        return equivalent_sigmas(float(away @ np.linalg.solve(spread, away)), len(at))

    distances: dict[tuple[str, ...], tuple[float, float]] = {
        (option,): (sigmas(option), shift) for option in given
    }
    if (
        len(given) > 1 and max(distances.values())[0] <= CONTRADICTION_SIGMAS
    ):  # no single one, but all of them
        distances[tuple(given)] = sigmas(*given), shift
    return distances
