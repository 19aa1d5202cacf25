"""The report's values from a solution and its data: everything that report.json, text and page show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import (
    NINE,
    BoolArray,
    Evidence,
    Extraction,
    FloatArray,
    Parameters,
    Solution,
    StereoRig,
)
from mobilecal_cli.report.case import Case
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.decomposition import error_parts
from mobilecal_cli.report.evaluation import evaluation_data
from mobilecal_cli.report.findings import (
    SCALES,
    contradiction_sentences,
    each_once,
    jackknife_sentence,
    outlier_sentences,
    reprojection_sentence,
    scale_sentence,
    suggestion_sentences,
)
from mobilecal_cli.report.numbers import (
    NEAR_LOCK_DEG,
    board_distance_m,
    image_coverage,
    lengths_mm,
    predicted_point_rms_m,
    reference_frame,
    reference_pose,
    rejection_counts,
    rotation_of,
    stations_looked_at,
)
from mobilecal_cli.report.plots import trail
from mobilecal_cli.report.tables import tables
from mobilecal_cli.report.use import recommendation
from mobilecal_cli.report.values import (
    BoardData,
    BudgetData,
    ChangeData,
    ConstantData,
    ContradictionData,
    EvidenceData,
    EvidenceValue,
    LegData,
    LinearData,
    LogsData,
    ParametersData,
    PathData,
    ProvenanceData,
    QualityData,
    RefinementData,
    RejectionCount,
    RejectionsData,
    ReportData,
    ResultData,
    ScaleData,
    StationData,
    SuggestionData,
    UncertaintyData,
)
from mobilecal_cli.report.verdict import verdict_data


def build_report(case: Case) -> ReportData:
    """All numbers, sentences and tables of a report."""
    solution, extraction = case.solution, case.extraction
    board, counts = extraction.board, rejection_counts(extraction)
    return ReportData(
        schema_version=5,
        verdict=verdict_data(case.verdict),
        metrics=case.verdict.metrics,
        parameters=_result(solution, extraction),
        quality=_quality(solution, extraction),
        linear=_linear(solution),
        refinement=_refinement(solution),
        legs=_legs(solution),
        uncertainty=_uncertainty(solution),
        outliers=solution.outliers,
        outliers_text=tuple(outlier_sentences(solution.outliers, extraction)),
        constants=_constants(solution),
        error_budget=_budget(solution),
        evidence=tuple(EvidenceData(**_evidence(found)) for found in solution.evidence),
        contradictions=tuple(_contradiction(found, solution, extraction) for found in each_once(solution)),
        scale=_scale(solution),
        logs=_between(solution),
        suggestions=_suggestions(solution, extraction),
        hold_out=None if case.trial is None else evaluation_data(case.trial),
        change=_change(case.change),
        stations=_stations(solution, extraction),
        paths=_paths(solution, extraction),
        motion=solution.motion,
        image_coverage=_coverage(extraction),
        board=BoardData(
            columns=board.columns,
            rows=board.rows,
            square_mm=_square_mm(extraction),
            square_from="measured" if board.square_m is None else "stated",
        ),
        rejections=RejectionsData(
            counts=tuple(
                RejectionCount(stage=stage, reason=reason, count=count)
                for (stage, reason), count in counts.items()
            ),
            items=extraction.rejections,
        ),
        counts={"images" if name == "pictures" else name: count for name, count in extraction.counts.items()},
        notes=extraction.notes,
        setting_sources=extraction.rig.setting_sources,
        provenance=ProvenanceData(
            tool="mobilecal", **{name: getattr(case.provenance, name) for name in _PROVENANCE}
        ),
        tables=tables(case),
    )


_PROVENANCE = ("version", "created", "method", "logs", "config")


def _row(values: FloatArray) -> tuple[Any, ...]:
    return tuple(values.tolist())


def _matrix(values: FloatArray, decimals: int | None = None) -> tuple[tuple[float, ...], ...]:
    shown = values if decimals is None else np.round(values, decimals)
    return tuple(tuple(row) for row in shown.tolist())


def _finite(value: float) -> float | None:
    """JSON has only finite numbers."""
    return value if math.isfinite(value) else None


def _by_name(values: FloatArray | BoolArray | Sequence[Any], names: Sequence[str] = NINE) -> dict[str, Any]:
    return dict(zip(names, np.asarray(values).tolist(), strict=True))


def _nine(parameters: Parameters, cameras: StereoRig) -> dict[str, Any]:
    T, lengths = reference_pose(parameters, cameras), lengths_mm(parameters, cameras)
    lock_deg = se3.gimbal_margin_deg(T[:3, :3])
    names = [f"{name}_mm" for name in (*(f"translation_{axis}" for axis in "xyz"), *NINE[6:])]
    return {
        **_by_name(lengths, names),
        "translation_m": _row(T[:3, 3]),
        "rotation_vector_deg": _row(np.degrees(se3.log_so3(T[:3, :3]))),
        "quaternion_xyzw": _row(se3.quaternion_xyzw(T[:3, :3])),
        "euler_zyx_deg": tuple(se3.euler_zyx_deg(T[:3, :3])) if lock_deg >= NEAR_LOCK_DEG else None,
        "gimbal_margin_deg": lock_deg,
    }


def _result(solution: Solution, extraction: Extraction) -> ResultData:
    rotation, cameras = rotation_of(solution), solution.cameras
    vector_std, euler_std = (
        None if std is None else _row(std) for std in (rotation.vector_std_deg, rotation.euler_std_deg)
    )
    return ResultData(
        **_nine(solution.parameters, cameras),
        rotation_vector_std_deg=vector_std,
        euler_zyx_std_deg=euler_std,
        parent_frame=extraction.rig.chain.head_frame,
        child_frame=reference_frame(cameras),
        camera=cameras.reference,
        rectified=cameras.rectified,
    )


def _quality(solution: Solution, extraction: Extraction) -> QualityData:
    parts = {name: part.px for name, part in error_parts(solution, extraction).items()}
    noise_px = 0.0 if solution.uncertainty is None else solution.uncertainty.noise.pixel_px
    return QualityData(
        stations=len(extraction.observations),
        stations_found=stations_looked_at(extraction),
        point_rms_mm=solution.point_rms_m * 1e3,
        point_rms_predicted_by_depth_noise_mm=predicted_point_rms_m(extraction, solution) * 1e3,
        reprojection_rms_px=solution.reprojection_rms_px,
        reprojection_parts_px=parts,
        reprojection_text=reprojection_sentence(parts, noise_px),
        board_distance_m=board_distance_m(extraction),
        method=solution.method,
    )


def _linear(solution: Solution) -> LinearData:
    linear, cameras = solution.linear, solution.cameras
    return LinearData(
        **_nine(linear.parameters, cameras),
        point_rms_mm=linear.point_rms_m * 1e3,
        second_best_point_rms_mm=_finite(linear.rival_point_rms_m * 1e3),
        iterations=linear.rounds,
        iterations_to_tolerance=linear.rounds_to_tolerance,
        initial_ratios=_row(linear.start_ratios),
        initial_from=linear.start_from,
        history=tuple(ParametersData(**_nine(parameters, cameras)) for parameters in linear.history),
    )


def _refinement(solution: Solution) -> RefinementData | None:
    found = solution.refinement
    return None if found is None else RefinementData(
        **_nine(found.parameters, solution.cameras),
        method=found.method,
        point_rms_mm=found.point_rms_m * 1e3,
        point_rms_history_mm=_row(found.point_rms_history_m * 1e3),
        evaluations=found.evaluations,
    )  # fmt: skip


def _legs(solution: Solution) -> tuple[LegData, ...]:
    found = solution.residuals
    errors = zip(
        found.legs.tolist(),
        (found.leg_point_rms_m * 1e3).tolist(),
        found.leg_reprojection_px.tolist(),
        strict=True,
    )
    return tuple(
        LegData(from_observation=first, to_observation=second, point_rms_mm=mm, reprojection_px=px)
        for (first, second), mm, px in errors
    )


def _uncertainty(solution: Solution) -> UncertaintyData | None:
    found = solution.uncertainty
    if found is None:
        return None
    covariance = found.reference_covariance
    std = np.sqrt(np.diag(covariance))
    known = np.where(std > 0, std, 1.0)
    return UncertaintyData(
        order=NINE,
        std=_by_name(std),
        covariance=_matrix(covariance),
        correlation=_matrix(covariance / np.outer(known, known)),
        observable=_by_name(found.observable),
        unobservable_directions=_matrix(found.unobservable),
        scales=_row(found.scales),
        singular_values=_row(found.singular_values),
        noise=found.noise,
        fixed=_by_name(found.fixed),
        jackknife_std=_by_name(found.jackknife_std),
        jackknife_text=jackknife_sentence(solution),
        widened=_by_name(found.widened),
        predicted=found.at_work,
    )


def _constants(solution: Solution) -> dict[str, ConstantData]:
    stated = {name: prior for c in reversed(solution.contradictions) for name, prior in c.priors.items()}
    return {
        name: ConstantData(
            kind=c.kind,
            part=c.part,
            meaning=c.meaning,
            unit=nuisance.kind(c.kind).unit,
            value=c.value,
            std=_finite(c.std),
            prior=_finite(stated.get(name, c.prior)),
            used_prior=_finite(c.prior),
        )
        for name, c in solution.constants.items()
    }


def _budget(solution: Solution) -> BudgetData | None:
    if solution.uncertainty is None:
        return None
    budget, said = solution.uncertainty.budget, recommendation(solution) or ("", "")
    shares = {name: _by_name(row, budget.sources) for name, row in zip(NINE, budget.nine.T, strict=True)}
    at_work = {field: _by_name(row, budget.sources) for field, row in budget.at_work.items()}
    return BudgetData(sources=budget.sources, nine=shares, at_work=at_work, limiting=said[0], advice=said[1])


def _evidence(found: Evidence) -> dict[str, Any]:
    names = ("kind", "part", "chi2", "sigmas", "shift_sigmas")
    return {name: getattr(found, name) for name in names} | {
        "values": {
            name: EvidenceValue(value=value, std=_finite(std), prior=found.priors[name])
            for name, (value, std) in found.values.items()
        }
    }


def _contradiction(found: Evidence, solution: Solution, extraction: Extraction) -> ContradictionData:
    text, cure = contradiction_sentences(found, solution, extraction)
    return ContradictionData(**_evidence(found), text=text, cure=cure)


def _scale(solution: Solution) -> ScaleData | None:
    scale = solution.scale
    return None if scale is None else ScaleData(
        ratio=scale.ratio,
        std=scale.std,
        square_m=scale.square_m,
        baseline_m=scale.baseline_m,
        consistent=not scale.apart and not any(found.kind in SCALES for found in solution.contradictions),
        text=scale_sentence(scale),
    )  # fmt: skip


def _between(solution: Solution) -> LogsData | None:
    found = solution.between
    if found is None:
        return None
    shift, std = (
        tuple(
            tuple(v if ok else None for v, ok in zip(row, oks, strict=True))
            for row, oks in zip(values.tolist(), found.shown.tolist(), strict=True)
        )
        for values in (found.shift, found.std)
    )
    shown = tuple(tuple(row) for row in found.shown.tolist())
    return LogsData(shift=shift, std=std, shown=shown, between_std=_row(found.between_std))


def _suggestions(solution: Solution, extraction: Extraction) -> tuple[SuggestionData, ...]:
    joints, sentences = extraction.rig.chain.joints, suggestion_sentences(solution, extraction)
    return tuple(
        SuggestionData(
            turn_deg=math.degrees(s.turn_rad),
            drive_m=s.drive_m,
            joints=_by_name(s.joints, joints),
            parameter=s.worst,
            std_now=s.std_now,
            std_then=s.std_then,
            gain=s.gain,
            text=text,
        )
        for s, text in zip(solution.suggestions, sentences, strict=True)
    )


def _change(change: Change | None) -> ChangeData | None:
    if change is None:
        return None
    value, sigmas, percent = (
        tuple(_finite(v) for v in values.tolist()) for values in (change.value, change.sigmas, change.percent)
    )
    against, chance = change.against, change.chance
    return ChangeData(
        against=against, order=NINE, value=value, sigmas=sigmas, percent=percent, p_value=chance
    )


def _stations(solution: Solution, extraction: Extraction) -> tuple[StationData, ...]:
    joints, residuals = extraction.rig.chain.joints, solution.residuals
    return tuple(
        StationData(
            log=o.log,
            station=o.station,
            time_ns=o.time_ns,
            at_rest=o.at_rest,
            joints=_by_name(o.joints, joints),
            images_left=o.left.pictures,
            images_right=o.right.pictures,
            corner_sigma_left_px=o.left.sigma_px,
            corner_sigma_right_px=o.right.sigma_px,
            stereo_reprojection_px=o.reprojection_px,
            square_mm=o.square_m * 1e3,
            board_distance_m=float(np.linalg.norm(o.points_c, axis=-1).mean()),
            base_x_m=float(T_w_v[0, 3]),
            base_y_m=float(T_w_v[1, 3]),
            base_heading_deg=math.degrees(math.atan2(T_w_v[1, 0], T_w_v[0, 0])),
            T_world_base=_matrix(T_w_v[:3], 6),
            T_world_camera=_matrix((T_w_k @ se3.inverse(o.T_c_k))[:3], 6),
            T_world_board=_matrix(T_w_k[:3], 6),
        )
        for o, T_w_v, T_w_k in zip(extraction.observations, residuals.T_w_v, residuals.T_w_k, strict=True)
    )


def _paths(solution: Solution, extraction: Extraction) -> tuple[PathData, ...]:
    """Path of the base in each recording, in the frame of the base at its first station."""
    seen, wheels = extraction.observations, solution.parameters.wheels
    times: Mapping[int, FloatArray] = {
        log: np.array([o.time_ns for o in seen if o.log == log]) for log in sorted({o.log for o in seen})
    }
    return tuple(
        PathData(log=log, points_m=_matrix(trail(extraction.wheels[log], at, wheels), 4))
        for log, at in times.items()
    )


def _coverage(extraction: Extraction) -> dict[str, float]:
    """Side → share of its image in which corners were detected, 0 to 1."""
    cameras, seen = extraction.rig.cameras, extraction.observations
    shares = {}
    for side, camera in (("left", cameras.left), ("right", cameras.right)) if seen else ():
        corners = [getattr(o, side) for o in seen]
        pixels = np.concatenate([c.pixels[c.seen] for c in corners])
        shares[side] = image_coverage(pixels, camera.width, camera.height)
    return shares


def _square_mm(extraction: Extraction) -> float | None:
    """Square size, mm: as stated, otherwise the median that the stereo pair measures; None without either."""
    if extraction.board.square_m is not None:
        return extraction.board.square_m * 1e3
    sizes = [o.square_m * 1e3 for o in extraction.observations]
    return float(np.median(sizes)) if sizes else None
