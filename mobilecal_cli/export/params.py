"""params.yaml: the nine numbers with their meaning, unit and origin; and its reader."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveFloat,
    ValidationError,
    field_validator,
    model_validator,
)

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.yaml_text import decimal, decimals, dump, exponential, quoted
from mobilecal_cli.model import (
    NINE,
    CalibratedRobot,
    Extraction,
    FloatArray,
    Knowledge,
    LogSource,
    Provenance,
    Side,
    Solution,
    StereoRig,
    WheelGeometry,
)
from mobilecal_cli.yaml_input import load_yaml

GIMBAL_WARNING_DEG = (
    5.0  # nearer to the lock than this, x and z trade places at ten times the noise of the axis
)
_HINT = "give a params.yaml that mobilecal calibrate wrote"


def params_yaml(solution: Solution, extraction: Extraction, provenance: Provenance) -> str:
    """The calibrated robot as commented YAML, the same bytes for the same values.

    ``head_eye`` speaks of the reference camera: T_h_reference = T_h_c T_c_reference. Where the pictures are
    rectified that is the rectified optical frame, and ``head_eye_raw`` names the raw one beside it:
    x_rect = R x_raw, so T_h_raw = T_h_rect R.

    Args:
        solution: the answer.
        extraction: what it was solved from.
        provenance: when, by which version, from which logs and settings.
    """
    cameras, chain = extraction.rig.cameras, extraction.rig.chain
    T_h_reference = solution.parameters.T_h_c @ cameras.T_c_reference
    frame = (cameras.left if cameras.reference == "left" else cameras.right).frame_id
    wheels = solution.parameters.wheels
    blocks = [
        "# Robot calibration by mobilecal. Lengths in m, angles in degrees where the key says so.",
        "schema_version: 1",
        "",
        *_head_eye_comment(cameras),
        "head_eye:",
        *_transform_lines(chain.head_frame, frame, T_h_reference),
        "",
        *(_raw_block(cameras, chain.head_frame, frame, T_h_reference) if cameras.rectified else []),
        "# Differential drive: both radii and the distance between the wheels' contact points.",
        "wheels:",
        f"  radius_left_m: {decimal(wheels.radius_left_m)}  # left wheel's radius, m",
        f"  radius_right_m: {decimal(wheels.radius_right_m)}  # right wheel's radius, m",
        f"  separation_m: {decimal(wheels.separation_m)}  # left contact point to right contact point, m",
        "",
        "# How well these numbers explain the recording; report.html says what to make of it.",
        "quality:",
        f"  stations: {len(extraction.observations)}  # moments at which both cameras saw the board",
        f"  point_rms_mm: {decimal(solution.point_rms_m * 1e3)}"
        "  # rms distance of board corners carried from station to station, mm",
        f"  reprojection_rms_px: {decimal(solution.reprojection_rms_px)}  # the same in the pictures, pixels",
        "",
        *_uncertainty_lines(solution, cameras),
        *_provenance_lines(provenance),
    ]
    return "\n".join(blocks) + "\n"


def _uncertainty_lines(solution: Solution, cameras: StereoRig) -> list[str]:
    """The contract's block; none for the methods that know no uncertainty."""
    found = solution.uncertainty
    if found is None:
        return []
    covariance = found.referred(solution.parameters.T_h_c, cameras.T_c_reference)
    covariance = (covariance + covariance.T) / 2
    std = np.sqrt(np.diag(covariance))
    seen = found.observable
    shown = ", ".join(
        f"{n}: {exponential(s) if ok else 'null'}" for n, s, ok in zip(NINE, std, seen, strict=True)
    )
    levels = found.noise
    return [
        "# How well the numbers are known: r is a small rotation vector in the head's frame, rad; lengths in m.",
        "# A number that is not observable is held at its nominal value: its std is null, and the covariance does",
        "# not speak of it.",
        "uncertainty:",
        f"  order: [{', '.join(NINE)}]",
        f"  std: {{{shown}}}",
        "  covariance:",
        *(f"    - [{', '.join(exponential(value) for value in row)}]" for row in covariance),
        f"  observable: {{{', '.join(f'{n}: {str(bool(ok)).lower()}' for n, ok in zip(NINE, seen, strict=True))}}}",
        f"  noise: {{pixel_px: {exponential(levels.pixel_px)}, "
        f"wheel_rad_per_sqrt_rad: {exponential(levels.wheel_rad_per_sqrt_rad)}, "
        f"joint_rad: {exponential(levels.joint_rad)}, estimated: {str(bool(levels.estimated)).lower()}}}",
        "",
    ]


def _head_eye_comment(cameras: StereoRig) -> list[str]:
    kind = "the rectified pictures'" if cameras.rectified else "the raw pictures'"
    return [
        "# Where the camera sits on the head: x_parent = R(quaternion) x_child + translation.",
        f"# The child is {kind} optical frame of the {cameras.reference} camera: x right, y down, z forward.",
    ]


def _raw_block(cameras: StereoRig, head_frame: str, frame: str, T_h_rectified: FloatArray) -> list[str]:
    R_rect_raw = cameras.R_rect_c if cameras.reference == "left" else cameras.R_rect_r
    T_h_raw = T_h_rectified @ se3.transform(R_rect_raw, np.zeros(3))
    return [
        "# The same camera's raw optical frame, which is the rectified one turned by camera_info's R:",
        "# x_rectified = R x_raw. Use it for pictures that are not rectified.",
        "head_eye_raw:",
        *_transform_lines(head_frame, f"{frame}_raw", T_h_raw),
        "",
    ]


def _transform_lines(parent: str, child: str, T_parent_child: FloatArray) -> list[str]:
    rotation = T_parent_child[:3, :3]
    x, y, z = (decimal(angle) for angle in se3.euler_zyx_deg(rotation))
    margin_deg = se3.gimbal_margin_deg(rotation)
    lock = [
        f"  # y is {margin_deg:.1f} degrees from gimbal lock: x and z have no meaning one by one.",
        "  # Use the quaternion.",
    ]
    return [
        f"  parent_frame: {quoted(parent)}  # head: last link of the pan-tilt chain",
        f"  child_frame: {quoted(child)}  # camera: optical frame",
        "  # x, y, z of the child's origin in the parent, m.",
        f"  translation_m: {decimals(T_parent_child[:3, 3])}",
        "  # Child's axes to parent's axes: a unit quaternion in the order x, y, z, w.",
        f"  quaternion_xyzw: {decimals(se3.quaternion_xyzw(rotation))}",
        "  # For reading: R = Rz(z) Ry(y) Rx(x), degrees, as in the paper's Table 1.",
        *(lock if margin_deg < GIMBAL_WARNING_DEG else []),
        f'  euler_zyx_deg: {{"x": {x}, "y": {y}, "z": {z}}}',  # YAML 1.1 reads a bare y as "true"
    ]


def _provenance_lines(provenance: Provenance) -> list[str]:
    body = dump(
        {
            "logs": [{"path": log.path, "sha256": log.sha256} for log in provenance.logs],
            "config": provenance.config,
        }
    )
    return [
        "# Where the numbers come from: the recordings, and the settings in force with what settled each.",
        "provenance:",
        '  tool: "mobilecal"',
        f"  version: {quoted(provenance.version)}  # of mobilecal",
        f"  created: {quoted(provenance.created)}  # UTC",
        f"  method: {quoted(provenance.method)}  # how the numbers were solved",
        *(f"  {line}" for line in body.removesuffix("\n").split("\n")),
    ]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class _HeadEye(_Section):
    parent_frame: str = Field(min_length=1)
    child_frame: str = Field(min_length=1)
    translation_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    quaternion_xyzw: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]

    @field_validator("quaternion_xyzw")
    @classmethod
    def _unit(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        norm = math.hypot(*value)
        if abs(norm - 1) > 1e-3:
            raise ValueError(f"has norm {norm:.6g}, not 1")
        return value


class _Wheels(_Section):
    radius_left_m: PositiveFloat = Field(allow_inf_nan=False)
    radius_right_m: PositiveFloat = Field(allow_inf_nan=False)
    separation_m: PositiveFloat = Field(allow_inf_nan=False)


_Row = Annotated[tuple[FiniteFloat, ...], Field(min_length=9, max_length=9)]


class _Uncertainty(_Section):
    order: tuple[str, ...]
    covariance: Annotated[tuple[_Row, ...], Field(min_length=9, max_length=9)]
    observable: dict[str, bool]

    @model_validator(mode="after")
    def _of_the_nine(self) -> _Uncertainty:
        if self.order != NINE or self.observable.keys() != set(NINE):
            raise ValueError(f"order and observable have to name {', '.join(NINE)}")
        covariance = np.array(self.covariance)
        if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=0) or np.any(np.diag(covariance) < 0):
            raise ValueError("covariance is not symmetric, or has a negative variance")
        return self


class _Log(_Section):
    path: str
    sha256: str


class _Wheel(_Section):
    joint: str | None = None


class _BothWheels(_Section):
    left: _Wheel = _Wheel()
    right: _Wheel = _Wheel()


class _Nominal(_Section):
    wheels: _Wheels | None = None


class _Settings(_Section):
    wheels: _BothWheels = _BothWheels()
    nominal: _Nominal = _Nominal()


class _Provenance(_Section):
    created: str = ""
    logs: tuple[_Log, ...] = ()
    config: _Settings = _Settings()


class _File(_Section):
    schema_version: int
    head_eye: _HeadEye
    wheels: _Wheels
    uncertainty: _Uncertainty | None = None
    provenance: _Provenance = _Provenance()

    @field_validator("schema_version")
    @classmethod
    def _known(cls, value: int) -> int:
        if value != 1:
            raise ValueError(f"is {value}, and this mobilecal reads 1")
        return value


def parameters_from_yaml(text: str, name: str = "params.yaml") -> CalibratedRobot:
    """Read the numbers, how well they are known and where they come from; other keys are left alone.

    Args:
        text: the file's contents.
        name: what to call it in messages.

    Raises:
        ConfigError: not YAML, another schema version, a missing key or a bad value.
    """
    try:
        data = load_yaml(text)
    except ValueError as error:
        raise ConfigError(f"{name}: not valid YAML: {' '.join(str(error).split())}", _HINT) from error
    if not isinstance(data, dict):
        raise ConfigError(f"{name}: holds no keys", _HINT)
    try:
        checked = _File.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_problems(error)}", _HINT) from error
    head_eye, wheels = checked.head_eye, checked.wheels
    rotation = se3.from_quaternion_xyzw(np.array(head_eye.quaternion_xyzw))
    known = checked.uncertainty
    knowledge = None
    if known is not None:
        knowledge = Knowledge(np.array(known.covariance), np.array([known.observable[name] for name in NINE]))
    settings = checked.provenance.config
    joints: dict[Side, str | None] = {
        "left": settings.wheels.left.joint,
        "right": settings.wheels.right.joint,
    }
    return CalibratedRobot(
        parent_frame=head_eye.parent_frame,
        child_frame=head_eye.child_frame,
        T_parent_child=se3.transform(rotation, np.array(head_eye.translation_m)),
        wheels=_geometry(wheels),
        knowledge=knowledge,
        created=checked.provenance.created,
        logs=tuple(LogSource(log.path, log.sha256) for log in checked.provenance.logs),
        wheel_joints={side: joint for side, joint in joints.items() if joint},
        nominal_wheels=_geometry(settings.nominal.wheels) if settings.nominal.wheels else None,
    )


def _geometry(wheels: _Wheels) -> WheelGeometry:
    return WheelGeometry(wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m)


def _problems(error: ValidationError) -> str:
    parts = []
    for item in error.errors():
        key = ".".join(str(part) for part in item["loc"])
        message = item["msg"].removeprefix("Value error, ")
        parts.append(f"{key}: {message}")
    return "; ".join(parts)
