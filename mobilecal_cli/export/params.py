"""params.yaml: the nine parameters with unit, uncertainty and provenance; writer and reader."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
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
    model_validator,
)

from mobilecal_cli import ranges, se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.text import dump, rendered
from mobilecal_cli.files.reading import mapping_of, problems_of
from mobilecal_cli.likelihood.constants import CONSTANTS, KIND_GROUPS, KINDS, joint_constants, kind_of
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot, Knowledge
from mobilecal_cli.model.findings import EstimatedConstant
from mobilecal_cli.model.observations import Extraction, LogSource
from mobilecal_cli.model.rig import FACTORS, AssumedOdometry, HeadChain, WheelGeometry, camera_words
from mobilecal_cli.model.solution import Provenance, Setting, Solution
from mobilecal_cli.rig.config import Pose, Radius, RigConfig, Separation, WheelsNominal, checked_settings

#: The beginning of every params.yaml, by which --force recognizes an output directory.
FIRST_LINE = "# Robot calibration by mobilecal."
#: Section with the sizes of the base → version of a file with it.
SCHEMA_VERSIONS = {"wheels": 3, "odometry": 4}
_FACTOR_ORDER = (*NINE[:6], *FACTORS[:3])
_SAME_ROTATION_DEG = 0.01
_SAME_STD = 1e-3
_ROUNDING = 1e-6  # of the correlations
_JOINT_POSITIONS = ("joint_zero", "backlash")  # kinds with the unit of the joint's position
_HINT = "use a params.yaml written by mobilecal calibrate"


def names_and_units(odometry: AssumedOdometry | None) -> tuple[tuple[str, ...], FloatArray]:
    """Names of the nine parameters in files, and (9,) what one is of each: factors stand for the wheels of odometry."""
    return (NINE, np.ones(9)) if odometry is None else (_FACTOR_ORDER, odometry.units)


def with_verdict(params: str, level: str, reasons: Sequence[str]) -> str:
    """params.yaml with a verdict in front of the first section.

    Args:
        params: as `params_yaml` writes it.
        level: "PASS", "FAIL", "NOT ENOUGH" or "GATE FAILED".
        reasons: why it is not PASS, whole sentences.
    """
    header, _, sections = params.partition("\n\n")
    return f"{header}\n\n{rendered('verdict.yaml', level=level, reasons=reasons)}\n{sections}"


def params_yaml(solution: Solution, extraction: Extraction, provenance: Provenance) -> str:
    """The calibrated robot as commented YAML, without a verdict, the same bytes for the same values.

    ``head_eye`` is the transform of the reference camera: T_h_reference = T_h_c T_c_reference. With rectified images,
    that is the rectified optical frame, and ``head_eye_raw`` adds the raw one: x_rect = R x_raw, so
    T_h_raw = T_h_rect R.

    Args:
        solution: the solution.
        extraction: its measurements.
        provenance: time, version, recordings and settings.
    """
    cameras, chain, uncertainty = solution.cameras, extraction.rig.chain, solution.uncertainty
    T_h_reference = solution.T_h_reference
    frame, wheels = cameras.of_reference.frame_id, solution.parameters.wheels
    odometry = extraction.rig.sources.assumed_odometry
    shown: dict[str, Any] = {"head_eye_raw": None}
    if cameras.rectified:
        R_rect_raw = cameras.R_rect[cameras.names.index(cameras.reference)]
        T_h_raw = T_h_reference @ se3.transform(R_rect_raw, np.zeros(3))
        shown["head_eye_raw"] = _transform(chain.head_frame, f"{frame}_raw", T_h_raw)
    if odometry is not None:
        shown["factors"] = odometry.factors(wheels).items()
    if uncertainty is not None:
        C, (order, units) = uncertainty.reference_covariance, names_and_units(odometry)
        covariance = (C + C.T) / 2 / np.outer(units, units)
        if odometry is not None:
            shown["factors_std"] = odometry.factors_std(wheels, C[6:, 6:]).items()
        shown |= {
            "order": order,
            "std": zip(order, np.sqrt(np.diag(covariance)), strict=True),
            "covariance": covariance.tolist(),
            "observable": zip(order, uncertainty.observable, strict=True),
            "constants": [
                (c, _unit(c, chain.prismatic)) for c in solution.constants.values() if c.prior > 0 or c.value
            ],
        }
    sources: Setting = {
        "logs": [{"path": log.path, "sha256": log.sha256} for log in provenance.logs],
        "cameras_sha256": extraction.rig.cameras.digest,
        "config": provenance.config,
    }
    return rendered(
        "params.yaml",
        first_line=FIRST_LINE,
        schema_version=SCHEMA_VERSIONS["wheels" if odometry is None else "odometry"],
        camera=camera_words(cameras.reference),
        kind="rectified" if cameras.rectified else "raw",
        head_eye=_transform(chain.head_frame, frame, T_h_reference),
        wheels=wheels,
        odometry=odometry,
        stations=len(extraction.observations),
        solution=solution,
        uncertainty=uncertainty,
        provenance=provenance,
        sources=dump(sources).removesuffix("\n"),
        **shown,
    )


def _transform(parent: str, child: str, T_parent_child: FloatArray) -> dict[str, Any]:
    rotation = T_parent_child[:3, :3]
    margin_deg = se3.gimbal_margin_deg(rotation)
    return {
        "parent": parent,
        "child": child,
        "translation_m": T_parent_child[:3, 3],
        "quaternion_xyzw": se3.quaternion_xyzw(rotation),
        "euler_deg": se3.euler_zyx_deg(rotation),
        "margin_deg": margin_deg,
        "near_lock": margin_deg < se3.NEAR_LOCK_DEG,
    }


def _unit(constant: EstimatedConstant, sliding: frozenset[str]) -> str:
    """Unit of a constant: rad, m, s or share; joints that slide are in m."""
    unit = {"1": "share"}.get(kind_of(constant.kind).unit, kind_of(constant.kind).unit)
    return "m" if constant.kind in _JOINT_POSITIONS and constant.part in sliding else unit


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


_Number = Annotated[FiniteFloat, Strict()]  # neither a text nor true


class _Euler(_Section):
    x: _Number
    y: _Number
    z: _Number


class _HeadEye(Pose):
    model_config = _Section.model_config

    parent_frame: str = Field(min_length=1)
    child_frame: str = Field(min_length=1)
    euler_zyx_deg: _Euler | None = None

    @model_validator(mode="after")
    def _one_rotation(self) -> _HeadEye:
        if self.euler_zyx_deg is not None:
            angles = self.euler_zyx_deg
            R = se3.from_rpy(np.radians([angles.x, angles.y, angles.z]))
            turn = se3.log_so3(R.T @ self.transform[:3, :3])
            apart_deg = math.degrees(float(np.linalg.norm(turn)))
            if apart_deg > _SAME_ROTATION_DEG:
                raise ValueError(f"euler_zyx_deg and quaternion_xyzw are {apart_deg:.3g} degrees apart")
        return self


class _Wheels(WheelsNominal):
    model_config = _Section.model_config


_Row = Annotated[tuple[_Number, ...], Field(min_length=9, max_length=9)]


class _Noise(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")

    __pydantic_extra__: dict[str, Annotated[_Number, AfterValidator(ranges.LEVEL.validated)]]
    estimated: Any = None


class _Uncertainty(_Section):
    order: tuple[str, ...]
    std: dict[str, _Number | None] | None = None
    covariance: Annotated[tuple[_Row, ...], Field(min_length=9, max_length=9)]
    observable: dict[str, bool]
    noise: _Noise = _Noise()

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
    assumed_radius_m: Radius
    assumed_separation_m: Separation
    assumed_separation_share: Annotated[_Number, Field(ge=0, le=10)] = 0.0

    @property
    def assumed(self) -> AssumedOdometry:
        wheels = WheelGeometry(self.assumed_radius_m, self.assumed_radius_m, self.assumed_separation_m)
        return AssumedOdometry(self.topic, wheels, self.assumed_separation_share)

    @property
    def geometry(self) -> WheelGeometry:
        return WheelGeometry.of(self.assumed.wheels.vector * [getattr(self, name) for name in FACTORS[:3]])


class _Constant(_Section):
    value: Annotated[_Number, AfterValidator(ranges.DIFFERENCE.validated)]
    sigma: Annotated[_Number, Field(ge=0)] = 0.0


class _Provenance(_Section):
    created: str = ""
    logs: tuple[LogSource, ...] = ()
    cameras_sha256: str = ""
    config: dict[str, Any] = {}


class _Verdict(_Section):
    level: Literal["PASS", "FAIL", "NOT ENOUGH", "GATE FAILED"]
    reasons: tuple[str, ...] = ()


class _File(_Section):
    schema_version: Literal[3, 4]
    verdict: _Verdict | None = None
    head_eye: _HeadEye
    head_eye_raw: _HeadEye | None = None
    wheels: _Wheels | None = None
    odometry: _Odometry | None = None
    uncertainty: _Uncertainty | None = None
    constants: dict[str, _Constant] = {}
    provenance: _Provenance = _Provenance()

    @model_validator(mode="after")
    def _wheels_or_odometry(self) -> _File:
        if (self.wheels is None) == (self.odometry is None):
            raise ValueError("wheels: missing" if self.wheels is None else "give wheels or odometry")
        of_factors = self.uncertainty is not None and self.uncertainty.order == _FACTOR_ORDER
        if of_factors != (self.odometry is not None and self.uncertainty is not None):
            raise ValueError("uncertainty.order does not belong to wheels or odometry")
        return self


def _chain_of(settings: RigConfig) -> HeadChain | None:
    """The head chain that the settings of a result state."""
    head, joints = settings.head, settings.joints
    if head.chain is None:
        return None
    links = tuple(link.stated for link in head.chain)
    return HeadChain(head.base_frame or "", head.head_frame or "", links, joints.pan or "", joints.tilt or "")


def _refuse_unknown(constants: Iterable[str], settings: RigConfig, name: str) -> None:
    """Refuse a constant that the robot of these settings cannot have: its value would be ignored."""
    chain, cameras = _chain_of(settings), {*settings.cameras.each, settings.cameras.reference or "left"}
    known = [row.name for row in (*CONSTANTS, *(() if chain is None else joint_constants(chain)))]
    of_head = KIND_GROUPS["head"]
    patterns = [
        kind.names if kind.name in of_head else kind.names.replace(".+", f"({'|'.join(cameras)})")
        for kind in KINDS
        if kind.names and (chain is None or kind.name not in of_head)
    ]
    for constant in constants:
        if constant not in known and not any(re.fullmatch(pattern, constant) for pattern in patterns):
            near = difflib.get_close_matches(constant, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"remove it; known: {', '.join(known)}"
            raise ConfigError(f"{name}: constants.{constant}: unknown constant", hint)


def parameters_from_yaml(text: str, name: str = "params.yaml") -> CalibratedRobot:
    """Read the parameters, their uncertainty and provenance; other keys are ignored.

    Args:
        name: its name in error messages.

    Raises:
        ConfigError: not YAML, another schema version, a missing key, an invalid value, or an unknown constant.
    """
    try:
        checked = _File.model_validate(mapping_of(text, name, _HINT))
    except ValidationError as error:
        raise ConfigError(f"{name}: {problems_of(error)}", _HINT) from error
    head_eye, verdict = checked.head_eye, checked.verdict
    known = checked.uncertainty
    odometry = None if checked.odometry is None else checked.odometry.assumed
    knowledge = None
    if known is not None:
        observable = np.array([known.observable[name] for name in known.order])
        _, units = names_and_units(odometry)
        knowledge = Knowledge(
            np.array(known.covariance) * np.outer(units, units), observable, known.noise.model_extra or {}
        )
    read_elsewhere = checked.provenance.config.get("joints", {})
    elsewhere = read_elsewhere.get("elsewhere", {}) if isinstance(read_elsewhere, dict) else {}
    settings = checked_settings(checked.provenance.config, f"{name}: provenance.config: ")
    joints = {side: wheel.side_joints for side, wheel in settings.wheels.of_sides.items()}
    _refuse_unknown(checked.constants, settings, name)
    sizes = checked.wheels or checked.odometry
    assert sizes is not None  # checked above
    return CalibratedRobot(
        parent_frame=head_eye.parent_frame,
        child_frame=head_eye.child_frame,
        T_parent_child=head_eye.transform,
        wheels=sizes.geometry,
        knowledge=knowledge,
        created=checked.provenance.created,
        logs=checked.provenance.logs,
        wheel_joints={side: names[0] for side, names in joints.items() if len(names) == 1},
        side_joints={side: names for side, names in joints.items() if len(names) > 1},
        odometry=odometry,
        nominal_wheels=settings.nominal.wheels.geometry if settings.nominal.wheels else None,
        head_joints=tuple(
            link.joint
            for link in settings.head.chain or ()
            if link.joint is not None and link.joint not in elsewhere
        ),
        rectified=checked.head_eye_raw is not None,
        constants={name: entry.value for name, entry in checked.constants.items()},
        constants_std={name: entry.sigma for name, entry in checked.constants.items()},
        chain=_chain_of(settings),
        cameras_sha256=checked.provenance.cameras_sha256,
        verdict="" if verdict is None else verdict.level,
        reasons=() if verdict is None else verdict.reasons,
        board=settings.board.stated if len(settings.cameras.each) == 1 else None,
    )
