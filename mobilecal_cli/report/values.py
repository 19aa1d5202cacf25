"""What report.json contains, as types: its schema, docs/reference/report.schema.json, is generated from them.

The end of a name is the unit: `_mm`, `_deg`, `_m`, `_rad`, `_px`, `_s`, `_ns`. None is an unknown value. By name: the
nine parameters in rad and m. Fields that end in `text` are sentences.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, TypeVar, dataclass_transform

from mobilecal_cli.model import AtWork, LogSource, NoiseLevels, Outlier, Rejection
from mobilecal_cli.report.verdict import VerdictData

Number: TypeAlias = float | None
Three: TypeAlias = tuple[float, float, float]
ByName: TypeAlias = Mapping[str, float]
Matrix: TypeAlias = tuple[tuple[float, ...], ...]
_T = TypeVar("_T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def _value(cls: type[_T]) -> type[_T]:
    """A frozen dataclass whose fields are given by name."""
    return dataclass(frozen=True, slots=True, kw_only=True)(cls)


@_value
class ParametersData:
    """The nine parameters, with the pose of the reference camera in the head; no Euler angles near gimbal lock."""

    rotation_vector_deg: Three
    quaternion_xyzw: tuple[float, float, float, float]
    euler_zyx_deg: Three | None
    gimbal_margin_deg: float
    translation_m: Three
    translation_x_mm: float
    translation_y_mm: float
    translation_z_mm: float
    radius_right_mm: float
    radius_left_mm: float
    separation_mm: float


@_value
class ResultData(ParametersData):
    """The result, with the standard deviations of the numbers that are written."""

    rotation_vector_std_deg: Three | None
    euler_zyx_std_deg: Three | None
    parent_frame: str
    child_frame: str
    camera: Literal["left", "right"]
    rectified: bool


@_value
class LinearData(ParametersData):
    """The linear solution; `history` has the parameters after each iteration."""

    point_rms_mm: float
    second_best_point_rms_mm: Number
    iterations: int
    iterations_to_tolerance: int
    initial_ratios: tuple[float, float]
    initial_from: str
    history: tuple[ParametersData, ...]


@_value
class RefinementData(ParametersData):
    """The refined solution."""

    method: str
    point_rms_mm: float
    point_rms_history_mm: tuple[float, ...]
    evaluations: int


@_value
class QualityData:
    """Errors of the result on the recordings; the parts are what each kind of noise contributes, to first order."""

    stations: int
    stations_found: int
    point_rms_mm: float
    point_rms_predicted_by_depth_noise_mm: float
    reprojection_rms_px: float
    reprojection_parts_px: ByName
    reprojection_text: str
    board_distance_m: float
    method: str


@_value
class LegData:
    """Errors of one leg, between two indices of `stations`."""

    from_observation: int
    to_observation: int
    point_rms_mm: float
    reprojection_px: float


@_value
class UncertaintyData:
    """Standard deviations and covariance, in the order of `order`; directions are in units of `scales`."""

    order: tuple[str, ...]
    std: ByName
    covariance: Matrix
    correlation: Matrix
    observable: Mapping[str, bool]
    unobservable_directions: Matrix
    scales: tuple[float, ...]
    singular_values: tuple[float, ...]
    noise: NoiseLevels
    fixed: Mapping[str, bool]
    jackknife_std: ByName
    jackknife_text: str
    widened: ByName
    predicted: AtWork


@_value
class ConstantData:
    """A constant of the robot description: true minus stated value, in `unit`."""

    kind: str
    part: str
    meaning: str
    unit: str
    value: float
    std: Number
    prior: Number
    used_prior: Number


@_value
class BudgetData:
    """Share of each source in each variance."""

    sources: tuple[str, ...]
    nine: Mapping[str, ByName]
    at_work: Mapping[str, ByName]
    limiting: str
    advice: str


@_value
class EvidenceValue:
    """A constant without its prior."""

    value: float
    std: Number
    prior: float


@_value
class EvidenceData:
    """How far the data contradict the stated values of one kind and part."""

    kind: str
    part: str
    chi2: float
    sigmas: float
    shift_sigmas: float
    values: Mapping[str, EvidenceValue]


@_value
class ContradictionData(EvidenceData):
    """Evidence beyond its limit."""

    text: str
    cure: str


@_value
class ScaleData:
    """The stated squares against the stereo baseline; `ratio` is measured over stated."""

    ratio: float
    std: float
    square_m: float
    baseline_m: float
    consistent: bool
    text: str


@_value
class LogsData:
    """Estimate from each recording alone minus the common one, and the spread between recordings."""

    shift: tuple[tuple[Number, ...], ...]
    std: tuple[tuple[Number, ...], ...]
    shown: tuple[tuple[bool, ...], ...]
    between_std: tuple[float, ...]


@_value
class SuggestionData:
    """An additional stop, and the standard deviation of `parameter` without and with it."""

    turn_deg: float
    drive_m: float
    joints: ByName
    parameter: str
    std_now: float
    std_then: float
    gain: float
    text: str


@_value
class SpreadData:
    """Root mean square, median and largest error of a leg."""

    rms: float
    median: float
    worst: float


@_value
class DriftData:
    """Drift of dead reckoning."""

    mm_per_m: Number
    deg_per_turn: Number


@_value
class LegErrorData:
    """Errors on one leg of a recording."""

    log: int
    from_station: int
    to_station: int
    reprojection_px: float
    rotation_deg: float
    translation_mm: float


@_value
class EvaluationData:
    """Errors of a calibration on stations that it was not made from."""

    stations: int
    legs: int
    driven_m: float
    turned_deg: float
    reprojection_px: SpreadData
    rotation_deg: SpreadData
    translation_mm: SpreadData
    drift_before: DriftData | None
    drift_after: DriftData
    per_leg: tuple[LegErrorData, ...]
    clock_offsets_s: ByName


@_value
class ChangeData:
    """Change from the last calibration or from the nominal values, in the order of `order`."""

    against: str
    order: tuple[str, ...]
    value: tuple[Number, ...]
    sigmas: tuple[Number, ...]
    percent: tuple[Number, ...]
    p_value: Number


@_value
class StationData:
    """One station; transforms are three rows, and the world is the base at the recording's first station."""

    log: int
    station: int
    time_ns: int
    at_rest: bool
    joints: ByName
    images_left: int
    images_right: int
    corner_sigma_left_px: float
    corner_sigma_right_px: float
    stereo_reprojection_px: float
    square_mm: float
    board_distance_m: float
    base_x_m: float
    base_y_m: float
    base_heading_deg: float
    T_world_base: Matrix
    T_world_camera: Matrix
    T_world_board: Matrix


@_value
class PathData:
    """Path of the base in one recording."""

    log: int
    points_m: Matrix


@_value
class BoardData:
    """The board: inner corners and squares."""

    columns: int
    rows: int
    square_mm: Number
    square_from: Literal["stated", "measured"]


@_value
class RejectionCount:
    """How many stations or images were rejected for one reason."""

    stage: str
    reason: str
    count: int


@_value
class RejectionsData:
    """What was rejected before the solve."""

    counts: tuple[RejectionCount, ...]
    items: tuple[Rejection, ...]


@_value
class ProvenanceData:
    """Version, time, recordings and settings."""

    tool: Literal["mobilecal"]
    version: str
    created: str
    method: str
    logs: tuple[LogSource, ...]
    config: Mapping[str, Any]


@_value
class TableData:
    """A table of the page, formatted; a column is text, a number, code, a name, the result ("strong") or a tag."""

    section: str
    title: str
    note: str
    heads: tuple[tuple[str, Literal["text", "number", "code", "name", "strong", "tag"]], ...]
    rows: tuple[tuple[str, ...], ...]


@_value
class ReportData:
    """All numbers, sentences and tables of a report."""

    schema_version: Literal[5]
    verdict: VerdictData
    metrics: Mapping[str, Number]
    parameters: ResultData
    quality: QualityData
    linear: LinearData
    refinement: RefinementData | None
    legs: tuple[LegData, ...]
    uncertainty: UncertaintyData | None
    outliers: tuple[Outlier, ...]
    outliers_text: tuple[str, ...]
    constants: Mapping[str, ConstantData]
    error_budget: BudgetData | None
    evidence: tuple[EvidenceData, ...]
    contradictions: tuple[ContradictionData, ...]
    scale: ScaleData | None
    logs: LogsData | None
    suggestions: tuple[SuggestionData, ...]
    hold_out: EvaluationData | None
    change: ChangeData | None
    stations: tuple[StationData, ...]
    paths: tuple[PathData, ...]
    motion: ByName
    image_coverage: ByName
    board: BoardData
    rejections: RejectionsData
    counts: Mapping[str, int]
    notes: tuple[str, ...]
    setting_sources: Mapping[str, str]
    provenance: ProvenanceData
    tables: tuple[TableData, ...]
