"""params.yaml: the nine parameters with unit, uncertainty and provenance; writer and reader."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    Strict,
    ValidationError,
    field_validator,
    model_validator,
)

from mobilecal_cli import ranges, se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.text import decimal, decimals, dump, exponential, quoted
from mobilecal_cli.files.reading import load_yaml, problems_of
from mobilecal_cli.likelihood.nuisance import kind as kind_of
from mobilecal_cli.model import (
    FACTORS,
    NINE,
    SIDES,
    AssumedOdometry,
    CalibratedRobot,
    CameraRig,
    EstimatedConstant,
    Extraction,
    FloatArray,
    Knowledge,
    LogSource,
    NoiseLevels,
    Provenance,
    Side,
    Solution,
    WheelGeometry,
    camera_words,
)
from mobilecal_cli.model.text import visible
from mobilecal_cli.rig.config import WheelsNominal, checked_settings

#: The beginning of every params.yaml, by which --force recognizes an output directory.
FIRST_LINE = "# Robot calibration by mobilecal."
SCHEMA_VERSION = 3
_OF_ODOMETRY = 4  # the version of files with the factors of odometry in place of wheels
_FACTOR_ORDER = (*NINE[:6], *FACTORS[:3])
_OLDEST_READ = 1  # no constants; no verdict up to 2
NEAR_LOCK_DEG = 5.0  # closer to gimbal lock, the noise of x and z is over ten times that of the axis
_SAME_ROTATION_DEG = 0.01
_SAME_STD = 1e-3
_ROUNDING = 1e-6  # of the correlations
_PLAIN_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_JOINT_POSITIONS = ("joint_zero", "backlash")  # kinds with the unit of the joint's position
_HINT = "use a params.yaml written by mobilecal calibrate"


def params_yaml(
    solution: Solution,
    extraction: Extraction,
    provenance: Provenance,
    verdict: str = "",
    reasons: Sequence[str] = (),
) -> str:
    """The calibrated robot as commented YAML, the same bytes for the same values.

    ``head_eye`` is the transform of the reference camera: T_h_reference = T_h_c T_c_reference. With rectified images,
    that is the rectified optical frame, and ``head_eye_raw`` adds the raw one: x_rect = R x_raw, so
    T_h_raw = T_h_rect R.

    Args:
        solution: the solution.
        extraction: its measurements.
        provenance: time, version, recordings and settings.
        verdict: "PASS", "FAIL", "NOT ENOUGH" or "GATE FAILED"; "" to state none.
        reasons: why it is not PASS, whole sentences.
    """
    cameras, chain = solution.cameras, extraction.rig.chain
    T_h_reference = solution.parameters.T_h_c @ cameras.T_c_reference
    frame = cameras.of_reference.frame_id
    wheels, odometry = solution.parameters.wheels, extraction.rig.sources.assumed_odometry
    kind = "rectified" if cameras.rectified else "raw"
    blocks = [
        f"{FIRST_LINE} Lengths in m, angles in rad unless the key says deg.",
        f"schema_version: {SCHEMA_VERSION if odometry is None else _OF_ODOMETRY}",
        "",
        *(_verdict_lines(verdict, reasons) if verdict else []),
        "# Head-eye transform, the pose of the camera on the head: x_parent = R(quaternion) x_child + translation.",
        f"# Child: the optical frame of the {camera_words(cameras.reference)} ({kind} images): "
        "x right, y down, z forward.",
        "head_eye:",
        *_transform_lines(chain.head_frame, frame, T_h_reference),
        "",
        *(_raw_block(cameras, chain.head_frame, frame, T_h_reference) if cameras.rectified else []),
        *(_wheel_lines(wheels) if odometry is None else _odometry_lines(solution, odometry)),
        "# Quality of the calibration; report.html explains these figures.",
        "quality:",
        f"  stations: {len(extraction.observations)}  # stations used",
        f"  point_rms_mm: {decimal(solution.point_rms_m * 1e3)}"
        "  # point error: station-to-station corner error in space, rms, mm",
        f"  reprojection_rms_px: {decimal(solution.reprojection_rms_px)}  # reprojection error: the same in px",
        "",
        *_uncertainty_lines(solution, odometry),
        *_constant_lines(solution, extraction),
        *_provenance_lines(provenance),
    ]
    return "\n".join(blocks) + "\n"


def _verdict_lines(verdict: str, reasons: Sequence[str]) -> list[str]:
    return [
        "# PASS: the calibration can be used. FAIL or NOT ENOUGH: it cannot, and export refuses it.",
        "verdict:",
        f"  level: {quoted(verdict)}",
        "  reasons:" if reasons else "  reasons: []",
        *(f"  - {quoted(visible(reason))}" for reason in reasons),
        "",
    ]


def _wheel_lines(wheels: WheelGeometry) -> list[str]:
    return [
        "# Differential drive: wheel radii and wheel separation.",
        "wheels:",
        f"  radius_left_m: {decimal(wheels.radius_left_m)}  # left wheel radius, m",
        f"  radius_right_m: {decimal(wheels.radius_right_m)}  # right wheel radius, m",
        f"  separation_m: {decimal(wheels.separation_m)}  # distance between the contact points, m",
        "",
    ]


def _odometry_lines(solution: Solution, odometry: AssumedOdometry) -> list[str]:
    """The block `odometry`, which stands in place of `wheels`."""
    wheels, found = solution.parameters.wheels, solution.uncertainty
    values = odometry.factors(wheels).tolist()
    lines = [f"  {name}: {decimal(value)}" for name, value in zip(FACTORS, values, strict=True)]
    if found is not None:
        std = np.sqrt(np.diag(odometry.covariance(wheels, found.reference_covariance[6:, 6:]))).tolist()
        shown = ", ".join(f"{name}: {exponential(s)}" for name, s in zip(FACTORS, std, strict=True))
        lines.append(f"  std: {{{shown}}}")
    return [
        "# Factors of the odometry, unit 1: the recording has no wheels, so no radius and no separation was measured.",
        "# The multipliers are those of diff_drive_controller, relative to the wheels in the driver. linear_scale is",
        "# true over measured distance, angular_scale true over measured rotation: drivers take these or those.",
        "# The driver is assumed to have a wheel separation of assumed_separation_m; the difference between the",
        "# multipliers of the two radii is in proportion to it, and the other factors do not depend on it.",
        "odometry:",
        f"  topic: {quoted(odometry.topic)}",
        *lines,
        f"  assumed_radius_m: {decimal(odometry.wheels.radius_right_m)}",
        f"  assumed_separation_m: {decimal(odometry.wheels.separation_m)}",
        f"  assumed_separation_share: {decimal(odometry.separation_share)}  # its relative standard deviation",
        "",
    ]


def _uncertainty_lines(solution: Solution, odometry: AssumedOdometry | None = None) -> list[str]:
    """The block `uncertainty`; empty for methods that give none."""
    uncertainty = solution.uncertainty
    if uncertainty is None:
        return []
    covariance = (uncertainty.reference_covariance + uncertainty.reference_covariance.T) / 2
    names = NINE
    lengths = "lengths in m."
    if odometry is not None:
        names, lengths = _FACTOR_ORDER, "lengths in m, factors in 1."
        units = _units(odometry.wheels)
        covariance = covariance / np.outer(units, units)
    std = np.sqrt(np.diag(covariance))
    observable = zip(names, uncertainty.observable, strict=True)
    shown = ", ".join(f"{n}: {exponential(s)}" for n, s in zip(names, std, strict=True))
    return [
        f"# Standard deviations and covariance: r is a small rotation vector in the head frame, rad; {lengths}",
        "# A parameter that the recording does not determine (observable: false) keeps its nominal value, and has the",
        "# standard deviation of a nominal value. Parameters fixed by the user have none.",
        "uncertainty:",
        f"  order: [{', '.join(names)}]",
        f"  std: {{{shown}}}",
        "  covariance:",
        *(f"    - [{', '.join(exponential(value) for value in row)}]" for row in covariance),
        f"  observable: {{{', '.join(f'{n}: {str(bool(ok)).lower()}' for n, ok in observable)}}}",
        f"  noise: {{{_noise(uncertainty.noise)}}}",
        "",
    ]


def _units(assumed: WheelGeometry) -> FloatArray:
    """(9,) m that a factor of one stands for; 1 for the head-eye transform."""
    return np.concatenate([np.ones(6), assumed.vector])


def _noise(levels: NoiseLevels) -> str:
    """Every noise level, and the names of those that were estimated from the residuals."""
    shown = (f"{name}: {exponential(level)}" for name, level in levels.levels.items())
    return f"{', '.join(shown)}, estimated: [{', '.join(levels.estimated)}]"


def _constant_lines(solution: Solution, extraction: Extraction) -> list[str]:
    """The block `constants`; empty for methods that estimate none."""
    if solution.uncertainty is None:
        return []
    sliding = extraction.rig.chain.prismatic
    changed = [constant for constant in solution.constants.values() if constant.prior > 0 or constant.value]
    return [
        "# Constants of the robot description: value is the difference from the stated value, sigma its standard",
        "# deviation, prior that of the stated value. Units: rad, m, s; share: relative, or of the image width.",
        "constants:" if changed else "constants: {}",
        *(_constant_line(constant, sliding) for constant in changed),
        "",
    ]


def _raw_block(cameras: CameraRig, head_frame: str, frame: str, T_h_rectified: FloatArray) -> list[str]:
    R_rect_raw = cameras.R_rect[cameras.names.index(cameras.reference)]
    T_h_raw = T_h_rectified @ se3.transform(R_rect_raw, np.zeros(3))
    return [
        "# The raw optical frame of the same camera: x_rectified = R x_raw with R from camera_info.",
        "# Use it for images that are not rectified.",
        "head_eye_raw:",
        *_transform_lines(head_frame, f"{frame}_raw", T_h_raw),
        "",
    ]


def _transform_lines(parent: str, child: str, T_parent_child: FloatArray) -> list[str]:
    rotation = T_parent_child[:3, :3]
    x, y, z = (decimal(angle) for angle in se3.euler_zyx_deg(rotation))
    margin_deg = se3.gimbal_margin_deg(rotation)
    euler = f'  euler_zyx_deg: {{"x": {x}, "y": {y}, "z": {z}}}'  # YAML 1.1 reads a bare y as "true"
    if margin_deg < NEAR_LOCK_DEG:
        euler = f"  euler_zyx_deg: null  # y is {margin_deg:.1f} degrees from gimbal lock: use the quaternion"
    return [
        f"  parent_frame: {quoted(parent)}  # last link of the head chain",
        f"  child_frame: {quoted(child)}  # optical frame of the camera",
        "  # Origin of the child in the parent: x, y, z, m.",
        f"  translation_m: {decimals(T_parent_child[:3, 3])}",
        "  # Rotation from the child to the parent, a unit quaternion in the order x, y, z, w.",
        f"  quaternion_xyzw: {decimals(se3.quaternion_xyzw(rotation))}",
        "  # For display only: R = Rz(z) Ry(y) Rx(x), deg.",
        euler,
    ]


def _provenance_lines(provenance: Provenance) -> list[str]:
    body = dump(
        {
            "logs": [{"path": log.path, "sha256": log.sha256} for log in provenance.logs],
            "config": provenance.config,
        }
    )
    return [
        "# Provenance: version, recordings, and the settings used with the source of each.",
        "provenance:",
        '  tool: "mobilecal"',
        f"  version: {quoted(provenance.version)}  # of mobilecal",
        f"  created: {quoted(provenance.created)}  # UTC",
        f"  method: {quoted(provenance.method)}  # see --method",
        *(f"  {line}" for line in body.removesuffix("\n").split("\n")),
    ]


def _unit(found: EstimatedConstant, sliding: frozenset[str]) -> str:
    """Unit of a constant: rad, m, s or share; joints that slide are in m."""
    unit = {"1": "share"}.get(kind_of(found.kind).unit, kind_of(found.kind).unit)
    return "m" if found.kind in _JOINT_POSITIONS and found.part in sliding else unit


def _constant_line(constant: EstimatedConstant, sliding: frozenset[str]) -> str:
    name = constant.name if _PLAIN_NAME.fullmatch(constant.name) else quoted(constant.name)
    numbers = (("value", constant.value), ("sigma", constant.std), ("prior", constant.prior))
    shown = ", ".join(f"{key}: {exponential(value)}" for key, value in numbers)
    return f"  {name}: {{{shown}, unit: {_unit(constant, sliding)}}}  # {visible(constant.part)}: {constant.meaning}"


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


_Number = Annotated[FiniteFloat, Strict()]  # neither a text nor true
_Length = Annotated[_Number, AfterValidator(ranges.POSITION.validated)]
_Radius = Annotated[_Number, AfterValidator(ranges.WHEEL_RADIUS.validated)]
_Separation = Annotated[_Number, AfterValidator(ranges.WHEEL_SEPARATION.validated)]


class _Euler(_Section):
    x: _Number
    y: _Number
    z: _Number


class _HeadEye(_Section):
    parent_frame: str = Field(min_length=1)
    child_frame: str = Field(min_length=1)
    translation_m: tuple[_Length, _Length, _Length]
    quaternion_xyzw: tuple[_Number, _Number, _Number, _Number]
    euler_zyx_deg: _Euler | None = None

    @field_validator("quaternion_xyzw")
    @classmethod
    def _unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        norm = math.hypot(*value)
        if abs(norm - 1) > 1e-3:
            raise ValueError(f"the norm is {norm:.6g}, expected 1")
        return value

    @model_validator(mode="after")
    def _one_rotation(self) -> _HeadEye:
        if self.euler_zyx_deg is not None:
            angles = self.euler_zyx_deg
            R = se3.from_rpy(np.radians([angles.x, angles.y, angles.z]))
            other = se3.from_quaternion_xyzw(np.array(self.quaternion_xyzw))
            apart_deg = math.degrees(float(np.linalg.norm(se3.log_so3(R.T @ other))))
            if apart_deg > _SAME_ROTATION_DEG:
                raise ValueError(f"euler_zyx_deg and quaternion_xyzw are {apart_deg:.3g} degrees apart")
        return self


class _Wheels(_Section):
    radius_left_m: _Radius
    radius_right_m: _Radius
    separation_m: _Separation


_Row = Annotated[tuple[_Number, ...], Field(min_length=9, max_length=9)]


class _Uncertainty(_Section):
    order: tuple[str, ...]
    std: dict[str, _Number | None] | None = None
    covariance: Annotated[tuple[_Row, ...], Field(min_length=9, max_length=9)]
    observable: dict[str, bool]
    noise: dict[str, Any] = {}

    @field_validator("noise")
    @classmethod
    def _levels(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name, level in value.items():
            number = isinstance(level, int | float) and not isinstance(level, bool)
            if name != "estimated" and not (number and level in ranges.LEVEL):
                raise ValueError(f"{name} must be from {ranges.LEVEL} (got {level!r})")
        return value

    @model_validator(mode="after")
    def _of_the_nine(self) -> _Uncertainty:
        names = _FACTOR_ORDER if self.order == _FACTOR_ORDER else NINE
        if self.order != names or self.observable.keys() != set(names):
            raise ValueError(f"order and observable must list {', '.join(names)}")
        covariance = np.array(self.covariance)
        if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=0) or np.any(np.diag(covariance) < 0):
            raise ValueError("the covariance is not symmetric or has a negative variance")
        std = np.sqrt(np.diag(covariance))
        scale = np.where(std > 0, std, 1.0)
        if np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() < -_ROUNDING:
            raise ValueError("the covariance is not positive semidefinite: no such uncertainty exists")
        for name, value in zip(names, std, strict=True):
            stated = (self.std or {}).get(name)
            if stated is not None and not math.isclose(stated, value, rel_tol=_SAME_STD):
                raise ValueError(f"std.{name} is {stated:g}, but the covariance gives {value:g}")
        return self


_Factor = Annotated[_Number, Field(gt=1e-3, lt=1e3)]


class _Odometry(_Section):
    topic: str = Field(min_length=1)
    right_wheel_radius_multiplier: _Factor
    left_wheel_radius_multiplier: _Factor
    wheel_separation_multiplier: _Factor
    assumed_radius_m: _Radius
    assumed_separation_m: _Separation
    assumed_separation_share: Annotated[_Number, Field(ge=0, le=10)] = 0.0

    @property
    def assumed(self) -> AssumedOdometry:
        wheels = WheelGeometry(self.assumed_radius_m, self.assumed_radius_m, self.assumed_separation_m)
        return AssumedOdometry(self.topic, wheels, self.assumed_separation_share)

    @property
    def wheels(self) -> WheelGeometry:
        factors = [
            self.right_wheel_radius_multiplier,
            self.left_wheel_radius_multiplier,
            self.wheel_separation_multiplier,
        ]
        return WheelGeometry.of(self.assumed.wheels.vector * factors)


class _Constant(_Section):
    value: Annotated[_Number, AfterValidator(ranges.DIFFERENCE.validated)]


class _Log(_Section):
    path: str
    sha256: str


class _Provenance(_Section):
    created: str = ""
    logs: tuple[_Log, ...] = ()
    config: dict[str, Any] = {}


class _Verdict(_Section):
    level: Literal["PASS", "FAIL", "NOT ENOUGH", "GATE FAILED"]
    reasons: tuple[str, ...] = ()


class _File(_Section):
    schema_version: int
    verdict: _Verdict | None = None
    head_eye: _HeadEye
    head_eye_raw: _HeadEye | None = None
    wheels: _Wheels | None = None
    odometry: _Odometry | None = None
    uncertainty: _Uncertainty | None = None
    constants: dict[str, _Constant] | None = None
    provenance: _Provenance = _Provenance()

    @field_validator("schema_version")
    @classmethod
    def _known(cls, value: int) -> int:
        if not _OLDEST_READ <= value <= _OF_ODOMETRY:
            raise ValueError(f"version {value} is not supported, only {_OLDEST_READ} to {_OF_ODOMETRY}")
        return value

    @model_validator(mode="after")
    def _wheels_or_odometry(self) -> _File:
        if (self.wheels is None) == (self.odometry is None):
            raise ValueError("wheels: Field required" if self.wheels is None else "give wheels or odometry")
        of_factors = self.uncertainty is not None and self.uncertainty.order == _FACTOR_ORDER
        if of_factors != (self.odometry is not None and self.uncertainty is not None):
            raise ValueError("uncertainty.order does not belong to wheels or odometry")
        return self


def parameters_from_yaml(text: str, name: str = "params.yaml") -> CalibratedRobot:
    """Read the parameters, their uncertainty and provenance; other keys are ignored.

    Args:
        text: the file's contents.
        name: its name in error messages.

    Raises:
        ConfigError: not YAML, another schema version, a missing key or an invalid value.
    """
    try:
        data = load_yaml(text)
    except ValueError as error:
        raise ConfigError(f"{name}: not valid YAML: {' '.join(str(error).split())}", _HINT) from error
    if not isinstance(data, dict):
        raise ConfigError(f"{name}: contains no keys", _HINT)
    try:
        checked = _File.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{name}: {problems_of(error)}", _HINT) from error
    head_eye, verdict, constants = checked.head_eye, checked.verdict, None
    if checked.constants is not None:
        constants = {name: entry.value for name, entry in checked.constants.items()}
    rotation = se3.from_quaternion_xyzw(np.array(head_eye.quaternion_xyzw))
    known = checked.uncertainty
    knowledge = None
    if known is not None:
        noise = {name: float(s) for name, s in known.noise.items() if name != "estimated"}
        observable = np.array([known.observable[name] for name in known.order])
        units = np.ones(9) if checked.odometry is None else _units(checked.odometry.assumed.wheels)
        knowledge = Knowledge(np.array(known.covariance) * np.outer(units, units), observable, noise)
    read_elsewhere = checked.provenance.config.get("joints", {})
    elsewhere = read_elsewhere.get("elsewhere", {}) if isinstance(read_elsewhere, dict) else {}
    settings = checked_settings(checked.provenance.config, f"{name}: provenance.config: ")
    joints: dict[Side, str | None] = {side: getattr(settings.wheels, side).joint for side in SIDES}
    several = {side: getattr(settings.wheels, side).joints for side in SIDES}
    odometry, wheels = checked.odometry, checked.wheels
    return CalibratedRobot(
        parent_frame=head_eye.parent_frame,
        child_frame=head_eye.child_frame,
        T_parent_child=se3.transform(rotation, np.array(head_eye.translation_m)),
        wheels=odometry.wheels
        if odometry is not None
        else _geometry(wheels)
        if wheels
        else WheelGeometry(1, 1, 1),
        knowledge=knowledge,
        created=checked.provenance.created,
        logs=tuple(LogSource(log.path, log.sha256) for log in checked.provenance.logs),
        wheel_joints={side: joint for side, joint in joints.items() if joint},
        side_joints={side: names for side, names in several.items() if names},
        odometry=None if odometry is None else odometry.assumed,
        nominal_wheels=_geometry(settings.nominal.wheels) if settings.nominal.wheels else None,
        head_joints=tuple(
            link.joint
            for link in settings.head.chain or ()
            if link.joint is not None and link.joint not in elsewhere
        ),
        rectified=checked.head_eye_raw is not None,
        constants=constants,
        verdict="" if verdict is None else verdict.level,
        reasons=() if verdict is None else verdict.reasons,
    )


def _geometry(wheels: _Wheels | WheelsNominal) -> WheelGeometry:
    return WheelGeometry(wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m)
