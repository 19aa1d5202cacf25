"""report.json: all numbers of the report, for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import (
    NINE,
    BoolArray,
    Evaluation,
    Evidence,
    Extraction,
    FloatArray,
    Parameters,
    Provenance,
    Solution,
    StereoRig,
)
from mobilecal_cli.report.at_work import recommendation
from mobilecal_cli.report.changes import Change
from mobilecal_cli.report.contradictions import contradiction_sentences
from mobilecal_cli.report.decomposition import error_parts
from mobilecal_cli.report.evaluation import check_data, evaluation_data
from mobilecal_cli.report.numbers import (
    NEAR_LOCK_DEG,
    QUANTITIES,
    board_distance_m,
    image_coverage,
    nine_numbers,
    predicted_point_rms_m,
    reference_frame,
    reference_pose,
    rejection_counts,
    rotation_of,
    stations_looked_at,
)
from mobilecal_cli.report.plots import trail
from mobilecal_cli.report.verdict import Verdict

SCHEMA_VERSION = 4
_COUNTS = {"pictures": "images"}


def report_json(
    solution: Solution,
    extraction: Extraction,
    provenance: Provenance,
    verdict: Verdict,
    trial: Evaluation | None = None,
    change: Change | None = None,
) -> str:
    """All numbers of the report: keys sorted, units as suffixes, the same bytes for the same values."""
    cameras = solution.cameras
    data = {
        "schema_version": SCHEMA_VERSION,
        "verdict": _verdict(verdict),
        "metrics": verdict.metrics,
        "parameters": _parameters(solution.parameters, cameras)
        | _rotation_std(solution)
        | {"parent_frame": extraction.rig.chain.head_frame, "child_frame": reference_frame(cameras)},
        "quality": _quality(solution, extraction),
        "linear": _linear(solution, cameras),
        "refinement": _refinement(solution, cameras),
        "legs": _legs(solution),
        "uncertainty": _uncertainty(solution),
        "outliers": [asdict(outlier) for outlier in solution.outliers],
        "constants": _constants(solution),
        "error_budget": _budget(solution),
        **_findings(solution, extraction),
        "hold_out": None if trial is None else evaluation_data(trial),
        "change": None
        if change is None
        else {
            "against": change.against,
            "order": NINE,
            "value": _finite(change.value.tolist()),
            "sigmas": _finite(change.sigmas.tolist()),
            "percent": _finite(change.percent.tolist()),
            "p_value": change.chance,
        },
        "stations": _stations(solution, extraction),
        "paths": _paths(solution, extraction),
        "motion": dict(solution.motion),
        "image_coverage": coverage(extraction),
        "board": {
            "columns": extraction.board.columns,
            "rows": extraction.board.rows,
            "square_mm": square_mm(extraction),
            "square_from": "measured" if extraction.board.square_m is None else "stated",
        },
        "rejections": {
            "counts": [
                {"stage": stage, "reason": reason, "count": count}
                for (stage, reason), count in rejection_counts(extraction).items()
            ],
            "items": [asdict(item) for item in extraction.rejections],
        },
        "counts": {_COUNTS.get(name, name): count for name, count in extraction.counts.items()},
        "notes": list(extraction.notes),
        "setting_sources": dict(extraction.rig.settled_by),
        "provenance": {
            "tool": "mobilecal",
            "version": provenance.version,
            "created": provenance.created,
            "method": provenance.method,
            "logs": [asdict(log) for log in provenance.logs],
            "config": provenance.config,
        },
    }
    return json.dumps(_tidy(data), indent=1, sort_keys=True, allow_nan=False) + "\n"


def _tidy(value: Any) -> Any:  # noqa: ANN401  (JSON is what it is)
    if isinstance(value, Mapping):
        return {str(key): _tidy(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _tidy(value.tolist())
    if isinstance(value, tuple | list):
        return [_tidy(item) for item in value]
    if isinstance(value, np.generic):
        return _tidy(value.item())
    if isinstance(value, float):
        return value + 0.0  # no -0.0
    return value


def _parameters(parameters: Parameters, cameras: StereoRig) -> dict[str, Any]:
    T = reference_pose(parameters, cameras)
    numbers = nine_numbers(parameters, cameras)
    lock_deg = se3.gimbal_margin_deg(T[:3, :3])
    return {
        **{quantity.key: float(value) for quantity, value in zip(QUANTITIES[3:], numbers[3:], strict=True)},
        "translation_m": T[:3, 3],
        "rotation_vector_deg": np.degrees(se3.log_so3(T[:3, :3])),
        "quaternion_xyzw": se3.quaternion_xyzw(T[:3, :3]),
        "euler_zyx_deg": se3.euler_zyx_deg(T[:3, :3]) if lock_deg >= NEAR_LOCK_DEG else None,
        "gimbal_margin_deg": lock_deg,
    }


def _rotation_std(solution: Solution) -> dict[str, Any]:
    rotation = rotation_of(solution)
    return {
        "rotation_vector_std_deg": rotation.vector_std_deg,
        "euler_zyx_std_deg": rotation.euler_std_deg,
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    return {
        "level": verdict.level,
        "reason": verdict.reason,
        "next_step": verdict.next_step,
        "checks": [check_data(check) for check in verdict.checks],
    }


def _quality(solution: Solution, extraction: Extraction) -> dict[str, Any]:
    return {
        "stations": len(extraction.observations),
        "stations_found": stations_looked_at(extraction),
        "point_rms_mm": solution.point_rms_m * 1e3,
        "point_rms_predicted_by_depth_noise_mm": predicted_point_rms_m(extraction, solution) * 1e3,
        "reprojection_rms_px": solution.reprojection_rms_px,
        "reprojection_parts_px": {name: p.px for name, p in error_parts(solution, extraction).items()},
        "board_distance_m": board_distance_m(extraction),
        "method": solution.method,
    }


def _linear(solution: Solution, cameras: StereoRig) -> dict[str, Any]:
    linear = solution.linear
    rival_m = linear.rival_point_rms_m
    return _parameters(linear.parameters, cameras) | {
        "point_rms_mm": linear.point_rms_m * 1e3,
        "second_best_point_rms_mm": rival_m * 1e3 if math.isfinite(rival_m) else None,
        "iterations": linear.rounds,
        "iterations_to_tolerance": linear.rounds_to_tolerance,
        "initial_ratios": linear.start_ratios,
        "initial_from": linear.start_from,
        "history": [_parameters(parameters, cameras) for parameters in linear.history],
    }


def _refinement(solution: Solution, cameras: StereoRig) -> dict[str, Any] | None:
    refinement = solution.refinement
    if refinement is None:
        return None
    return _parameters(refinement.parameters, cameras) | {
        "method": refinement.method,
        "point_rms_mm": refinement.point_rms_m * 1e3,
        "point_rms_history_mm": refinement.point_rms_history_m * 1e3,
        "evaluations": refinement.evaluations,
    }


def _legs(solution: Solution) -> list[dict[str, Any]]:
    residuals = solution.residuals
    return [
        {
            "from_observation": first,
            "to_observation": second,
            "point_rms_mm": residuals.leg_point_rms_m[leg] * 1e3,
            "reprojection_px": residuals.leg_reprojection_px[leg],
        }
        for leg, (first, second) in enumerate(residuals.legs.tolist())
    ]


def _uncertainty(solution: Solution) -> dict[str, Any] | None:
    found = solution.uncertainty
    if found is None:
        return None
    covariance = found.reference_covariance
    std = np.sqrt(np.diag(covariance))
    known = np.where(std > 0, std, 1.0)
    return {
        "order": NINE,
        "std": dict(zip(NINE, std.tolist(), strict=True)),
        "covariance": covariance,
        "correlation": covariance / np.outer(known, known),
        "observable": dict(zip(NINE, found.observable.tolist(), strict=True)),
        "unobservable_directions": found.unobservable,
        "scales": found.scales,
        "singular_values": found.singular_values,
        "noise": asdict(found.noise),
        "fixed": dict(zip(NINE, found.fixed.tolist(), strict=True)),
        "jackknife_std": dict(zip(NINE, found.jackknife_std.tolist(), strict=True)),
        "widened": dict(zip(NINE, found.widened.tolist(), strict=True)),
        "predicted": asdict(found.at_work),
    }


def _finite(values: Any) -> Any:  # noqa: ANN401  (nested lists)
    """Nested lists with None for numbers that are not finite, which JSON does not have."""
    if isinstance(values, list):
        return [_finite(value) for value in values]
    return values if math.isfinite(values) else None


def _where(known: BoolArray, values: FloatArray) -> list[list[float | None]]:
    """Rows of a matrix, with None where a value is not known."""
    return [
        [value if ok else None for ok, value in zip(oks, row, strict=True)]
        for oks, row in zip(known.tolist(), values.tolist(), strict=True)
    ]


def _findings(solution: Solution, extraction: Extraction) -> dict[str, Any]:
    between, scale = solution.between, solution.scale
    return {
        "evidence": [_evidence(found) for found in solution.evidence],
        "contradictions": [
            _evidence(found)
            | dict(zip(("text", "cure"), contradiction_sentences(found, solution), strict=True))
            for found in solution.contradictions
        ],
        "scale": None
        if scale is None
        else {
            "ratio": scale.ratio,
            "std": scale.std,
            "square_m": scale.square_m,
            "baseline_m": scale.baseline_m,
            "consistent": not scale.apart
            and not any(
                found.kind in ("square_size", "baseline_length") for found in solution.contradictions
            ),
        },
        "logs": {
            "shift": _where(between.shown, between.shift),
            "std": _where(between.shown, between.std),
            "shown": between.shown.tolist(),
            "between_std": between.between_std,
        }
        if between is not None
        else None,
        "suggestions": [
            {
                "turn_deg": math.degrees(s.turn_rad),
                "drive_m": s.drive_m,
                "joints": dict(zip(extraction.rig.chain.joints, s.joints.tolist(), strict=True)),
                "parameter": s.worst,
                "std_now": s.std_now,
                "std_then": s.std_then,
                "gain": s.gain,
            }
            for s in solution.suggestions
        ],
    }


def _constants(solution: Solution) -> dict[str, Any]:
    stated = {name: prior for c in reversed(solution.contradictions) for name, prior in c.priors.items()}
    return {
        name: {
            "kind": c.kind,
            "part": c.part,
            "unit": nuisance.kind(c.kind).unit,
            "value": c.value,
            "std": _finite(c.std),
            "prior": _finite(stated.get(name, c.prior)),
            "used_prior": _finite(c.prior),
        }
        for name, c in solution.constants.items()
    }


def _evidence(found: Evidence) -> dict[str, Any]:
    return {
        "kind": found.kind,
        "part": found.part,
        "chi2": found.chi2,
        "sigmas": found.sigmas,
        "shift_sigmas": found.shift_sigmas,
        "values": {
            name: {"value": value, "std": _finite(std), "prior": found.priors[name]}
            for name, (value, std) in found.values.items()
        },
    }


def _budget(solution: Solution) -> dict[str, Any] | None:
    """Shares of each source in each variance, and what limits the least certain figure."""
    if solution.uncertainty is None:
        return None
    budget, words = solution.uncertainty.budget, recommendation(solution)
    shares = dict(zip(NINE, budget.nine.T.tolist(), strict=True))
    return {
        "sources": budget.sources,
        "nine": {name: dict(zip(budget.sources, row, strict=True)) for name, row in shares.items()},
        "at_work": {
            field: dict(zip(budget.sources, row.tolist(), strict=True))
            for field, row in budget.at_work.items()
        },
        "limiting": words[0] if words else "",
        "advice": words[1] if words else "",
    }


def _stations(solution: Solution, extraction: Extraction) -> list[dict[str, Any]]:
    joints = extraction.rig.chain.joints
    return [
        {
            "log": o.log,
            "station": o.station,
            "time_ns": o.time_ns,
            "at_rest": o.at_rest,
            "joints": dict(zip(joints, o.joints.tolist(), strict=True)),
            "images_left": o.left.pictures,
            "images_right": o.right.pictures,
            "corner_sigma_left_px": o.left.sigma_px,
            "corner_sigma_right_px": o.right.sigma_px,
            "stereo_reprojection_px": o.reprojection_px,
            "square_mm": o.square_m * 1e3,
            "board_distance_m": float(np.linalg.norm(o.points_c, axis=-1).mean()),
            "base_x_m": T_w_v[0, 3],
            "base_y_m": T_w_v[1, 3],
            "T_world_base": _rows(T_w_v),
            "T_world_camera": _rows(T_w_k @ se3.inverse(o.T_c_k)),
            "T_world_board": _rows(T_w_k),
            "base_heading_deg": math.degrees(math.atan2(T_w_v[1, 0], T_w_v[0, 0])),
        }
        for o, T_w_v, T_w_k in zip(
            extraction.observations, solution.residuals.T_w_v, solution.residuals.T_w_k, strict=True
        )
    ]


def _rows(T: FloatArray) -> list[list[float]]:
    """The first three rows of a transform, to a hundredth of a millimeter."""
    rows: list[list[float]] = np.round(T[:3], 6).tolist()
    return rows


def _paths(solution: Solution, extraction: Extraction) -> list[dict[str, Any]]:
    """Path of the base in each recording, in the frame of the base at its first station."""
    seen, wheels = extraction.observations, solution.parameters.wheels
    return [
        {
            "log": log,
            "points_m": np.round(
                trail(extraction.wheels[log], np.array([o.time_ns for o in seen if o.log == log]), wheels), 4
            ),
        }
        for log in sorted({o.log for o in seen})
    ]


def coverage(extraction: Extraction) -> dict[str, float]:
    """Side → share of its image in which corners were detected, 0 to 1."""
    cameras, seen = extraction.rig.cameras, extraction.observations
    if not seen:
        return {}
    left = np.concatenate([o.left.pixels[o.left.seen] for o in seen])
    right = np.concatenate([o.right.pixels[o.right.seen] for o in seen])
    return {
        "left": image_coverage(left, cameras.left.width, cameras.left.height),
        "right": image_coverage(right, cameras.right.width, cameras.right.height),
    }


def square_mm(extraction: Extraction) -> float | None:
    """Square size, mm: as stated, otherwise the median that the stereo pair measures; None without either."""
    if extraction.board.square_m is not None:
        return extraction.board.square_m * 1e3
    sizes = [o.square_m * 1e3 for o in extraction.observations]
    return float(np.median(sizes)) if sizes else None
