"""What report.json contains, as types, and how a report is made of a solution and its data.

The schema of report.json, docs/reference/report.schema.json, is generated from these types. By name: the nine
parameters in rad and m. Fields that end in `text` are sentences.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import joint_frames
from mobilecal_cli.likelihood.constants import kind_of
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.findings import AtWork, Evidence
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.model.solution import NoiseLevels, Outlier, Provenance, Solution, Uncertainty
from mobilecal_cli.model.text import wrapped
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.evaluation import EvaluationData
from mobilecal_cli.report.findings import (
    SCALES,
    contradiction_sentences,
    outlier_sentences,
    reprojection_sentence,
    suggestion_sentences,
)
from mobilecal_cli.report.formats import (
    BoolMatrix,
    ByName,
    Four,
    JsonValue,
    Matrix,
    Number,
    NumberMatrix,
    Row,
    Table,
    Three,
    Two,
    by,
    like,
)
from mobilecal_cli.report.numbers import (
    NumberData,
    image_coverage,
    numbers_of,
    odometry_factors,
    rejection_counts,
    rotation_std_deg,
    stations_looked_at,
    stations_text,
    std_text,
    value_text,
)
from mobilecal_cli.report.plots import trail
from mobilecal_cli.report.tables import tables
from mobilecal_cli.report.use import LEAST_GAIN, cures_of, worst_error
from mobilecal_cli.report.verdict import Verdict, figures_of, verdict_of


class ParametersData(JsonValue):
    """The nine parameters, with the pose of the reference camera in the head; no Euler angles near gimbal lock."""

    rotation_vector_deg: Three
    quaternion_xyzw: Four
    euler_zyx_deg: Three | None
    gimbal_margin_deg: float
    translation_m: Three
    translation_x_mm: float
    translation_y_mm: float
    translation_z_mm: float
    radius_right_mm: Number
    radius_left_mm: Number
    separation_mm: Number


def _nine(case: Case, parameters: Parameters) -> ParametersData:
    """Parameters with the pose of the reference camera; with odometry alone nobody measured the wheels."""
    T, wheels = parameters.T_h_c @ case.solution.cameras.T_c_reference, parameters.wheels
    odometry = case.extraction.rig.sources.assumed_wheels is not None
    lock_deg, (x_mm, y_mm, z_mm) = se3.gimbal_margin_deg(T[:3, :3]), (T[:3, 3] * 1e3).tolist()
    return ParametersData(
        rotation_vector_deg=np.degrees(se3.log_so3(T[:3, :3])),
        quaternion_xyzw=se3.quaternion_xyzw(T[:3, :3]),
        euler_zyx_deg=np.array(se3.euler_zyx_deg(T[:3, :3])) if lock_deg >= se3.NEAR_LOCK_DEG else None,
        gimbal_margin_deg=lock_deg,
        translation_m=T[:3, 3],
        translation_x_mm=x_mm,
        translation_y_mm=y_mm,
        translation_z_mm=z_mm,
        radius_right_mm=None if odometry else wheels.radius_right_m * 1e3,
        radius_left_mm=None if odometry else wheels.radius_left_m * 1e3,
        separation_mm=None if odometry else wheels.separation_m * 1e3,
    )


class FactorData(JsonValue):
    """A factor of odometry."""

    value: float
    std: Number


class OdometryData(JsonValue):
    """Factors of the odometry, of a robot whose recording has no wheels.

    `uncertainty` has them as radii and separation of the assumed wheels, m.
    """

    topic: str
    factors: Mapping[str, FactorData]
    assumed_radius_m: float = by(lambda assumed: assumed.wheels.radius_right_m)
    assumed_separation_m: float = by(lambda assumed: assumed.wheels.separation_m)


def _odometry(case: Case) -> OdometryData | None:
    assumed = case.extraction.rig.sources.assumed_odometry
    values = odometry_factors(case.extraction.rig, case.solution).items()
    factors = {name: FactorData(value=value, std=std) for name, (value, std) in values}
    return None if assumed is None else like(OdometryData, assumed, factors=factors)


class ResultData(ParametersData):
    """The result, with the standard deviations of the numbers that are written."""

    rotation_vector_std_deg: Three | None = by(lambda case: rotation_std_deg(case.solution)[0])
    euler_zyx_std_deg: Three | None = by(lambda case: rotation_std_deg(case.solution)[1])
    parent_frame: str = by(lambda case: case.extraction.rig.chain.head_frame)
    child_frame: str = by(lambda case: case.solution.cameras.of_reference.frame_id)
    camera: str = by(lambda case: case.solution.cameras.reference)
    rectified: bool
    odometry: OdometryData | None = by(_odometry)

    @property
    def orientation(self) -> str:
        """Quaternion, and Euler angles with their standard deviations; without these near gimbal lock."""
        quaternion = ", ".join(f"{q:.6f}" for q in self.quaternion_xyzw)
        shown = f"Quaternion (x, y, z, w): {quaternion}."
        angles, stds = self.euler_zyx_deg, self.euler_zyx_std_deg
        if angles is None:
            margin = f"{self.gimbal_margin_deg:.1f}"
            return f"{shown} Euler angles are not shown: the orientation is {margin}° from gimbal lock."
        each = (
            f"{axis} = {value_text(angle, None if stds is None else stds[k], 3)}°"
            + ("" if stds is None else f" ± {std_text(stds[k])}°")
            for k, (axis, angle) in enumerate(zip("xyz", angles, strict=True))
        )
        return f"{shown} Euler angles, R = Rz(z) Ry(y) Rx(x): {', '.join(each)}."


class LinearData(ParametersData):
    """The linear solution; `history` has the parameters after each iteration."""

    point_rms_mm: float
    second_best_point_rms_mm: Number = by(lambda linear: linear.rival_point_rms_m * 1e3)
    iterations: int = by(lambda linear: linear.rounds)
    iterations_to_tolerance: int = by(lambda linear: linear.rounds_to_tolerance)
    initial_ratios: Two = by(lambda linear: linear.start_ratios)
    initial_from: str = by(lambda linear: linear.start_from)
    history: tuple[ParametersData, ...]


def _linear(case: Case) -> LinearData:
    linear = case.solution.linear
    history = tuple(_nine(case, each) for each in linear.history)
    return like(LinearData, linear, _nine(case, linear.parameters), history=history)


class RefinementData(ParametersData):
    """The refined solution."""

    method: str
    point_rms_mm: float
    point_rms_history_mm: Row
    evaluations: int


def _refinement(case: Case) -> RefinementData | None:
    refined = case.solution.refinement
    return None if refined is None else like(RefinementData, refined, _nine(case, refined.parameters))


class QualityData(JsonValue):
    """Errors of the result on the recordings; the parts are what each kind of noise contributes, to first order."""

    stations: int = by(lambda case: len(case.extraction.observations))
    stations_found: int = by(lambda case: stations_looked_at(case.extraction))
    stations_text: str = by(lambda case: stations_text(case.extraction))
    point_rms_mm: float
    point_rms_predicted_by_depth_noise_mm: float = by(
        lambda case: case.solution.residuals.corner_noise_m * 1e3
    )
    reprojection_rms_px: float
    reprojection_parts_px: ByName = by(
        lambda case: {name: part.px for name, part in case.solution.error_parts.items()}
    )
    reprojection_text: str = by(lambda case: reprojection_sentence(case.solution))
    board_distance_m: float
    method: str


class LegData(JsonValue):
    """Errors of one leg, between two indices of `stations`."""

    from_observation: int
    to_observation: int
    point_rms_mm: float
    reprojection_px: float


def _legs(case: Case) -> tuple[LegData, ...]:
    residuals = case.solution.residuals
    errors = residuals.leg_point_rms_m * 1e3, residuals.leg_reprojection_px
    return tuple(
        LegData(from_observation=i, to_observation=j, point_rms_mm=mm, reprojection_px=px)
        for (i, j), mm, px in zip(*(each.tolist() for each in (residuals.legs, *errors)), strict=True)
    )


def _by_parameter(name: str) -> Any:  # noqa: ANN401
    return by(lambda uncertainty: dict(zip(NINE, getattr(uncertainty, name).tolist(), strict=True)))


def _correlation(uncertainty: Uncertainty) -> FloatArray:
    C = uncertainty.reference_covariance
    std = np.sqrt(np.diag(C))
    known = np.where(std > 0, std, 1.0)
    return np.asarray(C / np.outer(known, known))


class UncertaintyData(JsonValue):
    """Standard deviations and covariance, in the order of `order`; directions are in units of `scales`."""

    order: tuple[str, ...] = by(lambda _: NINE)
    std: ByName = by(
        lambda of: dict(zip(NINE, np.sqrt(np.diag(of.reference_covariance)).tolist(), strict=True))
    )
    covariance: Matrix = by(lambda uncertainty: uncertainty.reference_covariance)
    correlation: Matrix = by(_correlation)
    observable: Mapping[str, bool] = _by_parameter("observable")
    described: Mapping[str, bool] = _by_parameter("described")
    unobservable_directions: Matrix = by(lambda uncertainty: uncertainty.unobservable)
    scales: Row
    singular_values: Row
    noise: NoiseLevels
    fixed: Mapping[str, bool] = _by_parameter("fixed")
    jackknife_std: ByName = _by_parameter("jackknife_std")
    widened: ByName = _by_parameter("widened")
    predicted: AtWork = by(lambda uncertainty: uncertainty.at_work)


class ConstantData(JsonValue):
    """A constant of the robot description: true minus stated value, in `unit`."""

    kind: str
    part: str
    meaning: str
    unit: str = by(lambda constant: kind_of(constant.kind).unit)
    value: float
    std: Number
    prior: Number
    used_prior: Number = by(lambda constant: constant.prior)


def _constants(case: Case) -> dict[str, ConstantData]:
    solution = case.solution
    stated = {  # before the priors of contradicted constants were widened
        name: each.prior
        for evidence in reversed(solution.contradictions)
        for name, each in evidence.values.items()
    }
    return {
        name: like(ConstantData, constant, prior=stated.get(name, constant.prior))
        for name, constant in solution.constants.items()
    }


class BudgetData(JsonValue):
    """Share of each source in each variance."""

    sources: tuple[str, ...]
    nine: Mapping[str, ByName]
    at_work: Mapping[str, ByName]
    limiting: str


def _budget(case: Case) -> BudgetData | None:
    solution = case.solution
    if solution.uncertainty is None:
        return None
    error, budget = worst_error(solution, case.gates), solution.uncertainty.budget
    nine, at_work = (
        {name: dict(zip(budget.sources, shares.tolist(), strict=True)) for name, shares in columns}
        for columns in (zip(NINE, budget.nine.T, strict=True), budget.at_work.items())
    )
    return like(BudgetData, budget, nine=nine, at_work=at_work, limiting=error.limiting if error else "")


class ContradictionData(Evidence, JsonValue):
    """Evidence beyond its limit."""

    text: str
    cure: str


def _contradictions(case: Case) -> tuple[ContradictionData, ...]:
    return tuple(
        like(ContradictionData, evidence, text=text, cure=cure)
        for evidence in case.solution.contradictions
        for text, cure in [contradiction_sentences(evidence, case.solution, case.extraction)]
    )


class ScaleData(JsonValue):
    """The stated squares against the stereo baseline; `ratio` is measured over stated."""

    ratio: float
    std: float
    square_m: float
    baseline_m: float
    consistent: bool


def _scale(case: Case) -> ScaleData | None:
    scale, wrong = case.solution.scale, {evidence.kind for evidence in case.solution.contradictions}
    apart = scale is not None and (scale.apart or SCALES & wrong)
    return None if scale is None else like(ScaleData, scale, consistent=not apart)


class LogsData(JsonValue):
    """Estimate from each recording alone minus the common one, and the spread between recordings."""

    shift: NumberMatrix = by(lambda between: np.where(between.shown, between.shift, np.nan))
    std: NumberMatrix = by(lambda between: np.where(between.shown, between.std, np.nan))
    shown: BoolMatrix
    between_std: Row


class SuggestionData(JsonValue):
    """An additional stop, and the standard deviation of `parameter` without and with it."""

    turn_deg: float
    drive_m: float
    face_deg: float
    joints: ByName
    parameter: str = by(lambda suggestion: suggestion.worst)
    std_now: float
    std_then: float
    gain: float
    text: str


def _suggestions(solution: Solution, extraction: Extraction) -> tuple[SuggestionData, ...]:
    joints, sentences = extraction.rig.chain.joints, suggestion_sentences(solution, extraction)
    return tuple(
        like(SuggestionData, s, joints=dict(zip(joints, s.joints.tolist(), strict=True)), text=text)
        for s, text in zip(solution.suggestions, sentences, strict=True)
    )


class StationData(JsonValue):
    """One station; transforms are three rows, and the world is the base at the recording's first station."""

    log: int
    station: int
    time_ns: int
    at_rest: bool
    joints: ByName
    images: ByName
    corner_sigma_px: ByName
    stereo_reprojection_px: float = by(lambda observation: observation.reprojection_px)
    square_mm: float
    board_distance_m: float = by(lambda o: float(np.linalg.norm(o.points_c, axis=-1).mean()))
    base_x_m: float
    base_y_m: float
    base_heading_deg: float
    T_world_base: Matrix
    T_world_camera: Matrix
    T_world_board: Matrix


def _stations(case: Case) -> tuple[StationData, ...]:
    rig, residuals = case.extraction.rig, case.solution.residuals
    joints, cameras = rig.chain.joints, rig.cameras.names
    each = zip(case.extraction.observations, residuals.T_w_v, residuals.T_w_c, residuals.T_w_k, strict=True)
    return tuple(
        like(
            StationData,
            o,
            joints=dict(zip(joints, o.joints.tolist(), strict=True)),
            images={name: view.pictures for name, view in zip(cameras, o.views, strict=True)},
            corner_sigma_px={
                name: view.sigma_px for name, view in zip(cameras, o.views, strict=True) if view.pictures
            },
            base_x_m=float(T_w_v[0, 3]),
            base_y_m=float(T_w_v[1, 3]),
            base_heading_deg=math.degrees(math.atan2(T_w_v[1, 0], T_w_v[0, 0])),
            T_world_base=np.round(T_w_v[:3], 6),
            T_world_camera=np.round(T_w_c[:3], 6),
            T_world_board=np.round(T_w_k[:3], 6),
        )
        for o, T_w_v, T_w_c, T_w_k in each
    )


class FrameData(JsonValue):
    """A frame of the head in the one before, three rows; it turns (or moves) by the reading times `axis`."""

    name: str
    T_parent_frame: Matrix
    axis: Three
    prismatic: bool


def _frames(case: Case) -> tuple[FrameData, ...]:
    chain = case.extraction.rig.chain
    joints, T_head = joint_frames(chain)
    frames = [(link.joint, T, link.multiplier * link.axis, link.kind == "prismatic") for link, T in joints]
    frames.append((chain.head_frame, T_head, np.zeros(3), False))
    return tuple(
        FrameData(name=name, T_parent_frame=T[:3], axis=axis, prismatic=prismatic)
        for name, T, axis, prismatic in frames
    )


class RobotData(JsonValue):
    """Frames from the base to the head, and the poses of the reference camera in the head, three rows each."""

    base_frame: str = by(lambda case: case.extraction.rig.chain.base_frame)
    frames: tuple[FrameData, ...] = by(_frames)
    camera: Matrix = by(lambda case: case.solution.T_h_reference[:3])
    nominal_camera: Matrix | None = by(
        lambda case: None if (T := case.extraction.rig.nominal.T_h_reference) is None else T[:3]
    )


class PathData(JsonValue):
    """Path of the base in one recording."""

    log: int
    points_m: Matrix


def _paths(case: Case) -> tuple[PathData, ...]:
    logs, wheels = {o.log for o in case.extraction.observations}, case.solution.parameters.wheels
    return tuple(
        PathData(log=log, points_m=np.round(trail(case.extraction, log, wheels), 4)) for log in sorted(logs)
    )


class BoardData(JsonValue):
    """The board: inner corners and squares."""

    columns: int
    rows: int
    square_mm: Number
    square_from: Literal["stated", "measured"] = by(
        lambda extraction: "measured" if extraction.board.square_m is None else "stated"
    )


class RejectionCount(JsonValue):
    """How many stations or images were rejected for one reason."""

    stage: str
    reason: str
    count: int


class RejectionsData(JsonValue):
    """What was rejected before the solve."""

    counts: tuple[RejectionCount, ...] = by(
        lambda extraction: tuple(
            RejectionCount(stage=stage, reason=reason, count=count)
            for (stage, reason), count in rejection_counts(extraction).items()
        )
    )
    items: tuple[Rejection, ...] = by(lambda extraction: extraction.rejections)


class ProvenanceData(Provenance, JsonValue):
    """Version, time, recordings and settings."""

    tool: Literal["mobilecal"] = by(lambda _: "mobilecal")
    config: Mapping[str, Any]


class ReportData(JsonValue):
    """All numbers, sentences and tables of a report."""

    schema_version: Literal[7] = by(lambda _: 7)
    verdict: Verdict = by(verdict_of)
    numbers: tuple[NumberData, ...] = by(lambda case: numbers_of(case.solution, case.extraction.rig))
    metrics: Mapping[str, Number] = by(figures_of)
    parameters: ResultData = by(
        lambda case: like(ResultData, case, _nine(case, case.solution.parameters), case.solution.cameras)
    )
    quality: QualityData = by(lambda case: like(QualityData, case, case.solution, case.extraction))
    linear: LinearData = by(_linear)
    refinement: RefinementData | None = by(_refinement)
    legs: tuple[LegData, ...] = by(_legs)
    uncertainty: UncertaintyData | None = by(
        lambda case: case.solution.uncertainty and like(UncertaintyData, case.solution.uncertainty)
    )
    outliers: tuple[Outlier, ...]
    outliers_text: tuple[str, ...] = by(
        lambda case: tuple(outlier_sentences(case.solution.outliers, case.extraction))
    )
    constants: Mapping[str, ConstantData] = by(_constants)
    error_budget: BudgetData | None = by(_budget)
    evidence: tuple[Evidence, ...]
    contradictions: tuple[ContradictionData, ...] = by(_contradictions)
    scale: ScaleData | None = by(_scale)
    logs: LogsData | None = by(lambda case: case.solution.between and like(LogsData, case.solution.between))
    suggestions: tuple[SuggestionData, ...] = by(lambda case: _suggestions(case.solution, case.extraction))
    hold_out: EvaluationData | None = by(lambda case: case.trial and like(EvaluationData, case.trial))
    change: Change | None
    stations: tuple[StationData, ...] = by(_stations)
    robot: RobotData = by(lambda case: like(RobotData, case))
    paths: tuple[PathData, ...] = by(_paths)
    motion: ByName
    image_coverage: ByName = by(
        lambda case: {
            name: image_coverage(case.extraction, k)
            for k, name in enumerate(case.extraction.rig.cameras.names)
        }
    )
    board: BoardData = by(lambda case: like(BoardData, case.extraction, case.extraction.board))
    rejections: RejectionsData = by(lambda case: like(RejectionsData, case.extraction))
    counts: Mapping[str, int] = by(
        lambda case: {
            "images" if name == "pictures" else name: count for name, count in case.extraction.counts.items()
        }
    )
    notes: tuple[str, ...]
    setting_sources: Mapping[str, str] = by(lambda case: case.extraction.rig.setting_sources)
    provenance: ProvenanceData = by(lambda case: like(ProvenanceData, case.provenance))
    tables: tuple[Table, ...] = by(tables)


def build_report(case: Case) -> ReportData:
    """All numbers, sentences and tables of a report."""
    return like(ReportData, case, case.solution, case.extraction)


class Advice(JsonValue):
    """What limits a result, and what improves it by 5 % or more."""

    limiting: str
    cures: tuple[str, ...]
    stops: tuple[SuggestionData, ...]

    @property
    def lines(self) -> list[str]:
        """For the terminal, escaped."""
        about = "Additional stop at the end of this recording, most useful first:"
        if not self.stops:
            about = "No further stop near the last one improves a parameter by 5 % or more."
        lines = [line for text in (self.limiting, *self.cures, about) for line in wrapped(text, "", "  ")]
        for number, stop in enumerate(self.stops, 1):
            lines += wrapped(stop.text, f"{number}. ")
        return lines


def advice_on(solution: Solution, extraction: Extraction, limits: Mapping[str, float]) -> Advice:
    """What limits a solution, its cures from the cheapest on, and the stops that improve it; limits as for `uses`."""
    error = worst_error(solution, limits)
    return Advice(
        limiting="" if error is None else error.limiting,
        cures=() if error is None else tuple(c.text(error) for c in cures_of(error, solution, extraction)),
        stops=tuple(stop for stop in _suggestions(solution, extraction) if stop.gain >= LEAST_GAIN),
    )
