"""Numbers of the report: the nine parameters with their names and units, and what follows from a solution and its data.

A value is shown with the digits that its standard deviation justifies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import encoder_steps_rad
from mobilecal_cli.model import NINE, Extraction, FloatArray, Parameters, Rejection, Solution, StereoRig

_MOST_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the nine parameters.

    Attributes:
        name: as in params.yaml.
        symbol: in the paper; for a rotation, the component of the rotation vector.
        label: in a summary.
        meaning: what its standard deviation is of.
        unit: "rad" or "m".
        shown_unit, factor: unit for people, and how many of it one `unit` is.
        digits: decimals to show where no standard deviation is known.
    """

    name: str
    symbol: str
    label: str
    meaning: str
    unit: str
    shown_unit: str
    factor: float
    digits: int

    @property
    def key(self) -> str:
        """Name with the unit for people, for columns of numbers."""
        return f"{self.name}_{self.shown_unit}"

    @property
    def gate(self) -> str:
        """Name of the gate on its standard deviation."""
        return f"std.{'wheels' if self.name in NINE[6:] else 'head_eye'}.{self.name}_{self.unit}"


def _rotation(axis: str) -> Parameter:
    meaning = f"small rotation about the head's {axis} axis"
    return Parameter(
        f"r_{axis}", f"r{axis}", f"rotation vector {axis}", meaning, "rad", "deg", 180 / math.pi, 3
    )


def _length(name: str, symbol: str, label: str, meaning: str = "") -> Parameter:
    return Parameter(name, symbol, label, meaning or label, "m", "mm", 1e3, 2)


PARAMETERS = (
    *(_rotation(axis) for axis in "xyz"),
    *(
        _length(f"t_{axis}", f"t{axis}", f"translation {axis}", f"camera position in the head frame, {axis}")
        for axis in "xyz"
    ),
    _length("radius_right", "rR", "right wheel radius"),
    _length("radius_left", "rL", "left wheel radius"),
    _length("separation", "b", "wheel separation"),
)
BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}


def value_text(value: float, std: float | None, otherwise: int, sign: str = "") -> str:
    """A value with as many decimals as its standard deviation shows.

    Args:
        value: the value.
        std: its standard deviation in the same unit; None where it is unknown.
        otherwise: decimals where there is no positive standard deviation.
        sign: "+" writes the sign of positive values too.
    """
    return f"{value:{sign}.{otherwise if std is None else decimals_of(std, otherwise)}f}"


def std_text(std: float) -> str:
    """A standard deviation or an error with two significant digits, never rounded to zero."""
    return f"{std:.1e}" if 0 < std < 10.0**-_MOST_DECIMALS else f"{std:.{decimals_of(std)}f}"


def decimals_of(std: float, otherwise: int = 3) -> int:
    """Decimals of a value that match two significant digits of its standard deviation.

    Args:
        std: the standard deviation.
        otherwise: decimals where it is zero or not finite.
    """
    if not (math.isfinite(std) and std > 0):
        return otherwise
    exponent = int(f"{std:.1e}".partition("e")[2])
    return min(max(1 - exponent, 0), _MOST_DECIMALS)


#: Euler angles are shown only if they are further than this from gimbal lock, where x and z are not unique.
NEAR_LOCK_DEG = 5.0
_STEP_RAD = 1e-5


def reference_pose(parameters: Parameters, cameras: StereoRig) -> FloatArray:
    """Head-eye transform of the reference camera, (4, 4): camera coordinates to head coordinates, m."""
    T: FloatArray = parameters.T_h_c @ cameras.T_c_reference
    return T


def reference_frame(cameras: StereoRig) -> str:
    """Name of the optical frame of the reference camera."""
    return (cameras.left if cameras.reference == "left" else cameras.right).frame_id


def lengths_mm(parameters: Parameters, cameras: StereoRig) -> FloatArray:
    """Translation of the reference camera, radii and separation, (6,) mm."""
    return 1e3 * np.concatenate([reference_pose(parameters, cameras)[:3, 3], parameters.wheels.vector])


@dataclass(frozen=True, slots=True, eq=False)
class Rotation:
    """Rotation of the reference camera in the head frame; each standard deviation is that of the number beside it.

    Attributes:
        vector_deg: (3,) rotation vector, norm at most 180 degrees.
        vector_std_deg: (3,) 1 sigma of its components; None if any part of the rotation is fixed by the user.
        quaternion_xyzw: (4,) unit quaternion with w >= 0.
        euler_deg: (3,) angles x, y, z with R = Rz(z) Ry(y) Rx(x); None within `NEAR_LOCK_DEG` of gimbal lock.
        euler_std_deg: (3,) 1 sigma of these angles; None where `euler_deg` or `vector_std_deg` is None.
        lock_deg: distance from gimbal lock.
    """

    vector_deg: FloatArray
    vector_std_deg: FloatArray | None
    quaternion_xyzw: FloatArray
    euler_deg: FloatArray | None
    euler_std_deg: FloatArray | None
    lock_deg: float


def rotation_of(solution: Solution) -> Rotation:
    """Rotation vector, quaternion and Euler angles of the reference camera, with first-order standard deviations.

    The covariance is that of a small rotation r about the head's axes: `R_true = exp(r) R`.
    """
    R = reference_pose(solution.parameters, solution.cameras)[:3, :3]
    vector_deg, found = np.degrees(se3.log_so3(R)), solution.uncertainty
    lock_deg = se3.gimbal_margin_deg(R)
    euler_deg = np.array(se3.euler_zyx_deg(R)) if lock_deg >= NEAR_LOCK_DEG else None
    vector_std = euler_std = None
    if found is not None and None not in reference_std(solution)[:3]:
        C = found.reference_covariance[:3, :3]
        J = np.linalg.inv(se3.left_jacobian_so3(np.radians(vector_deg)))
        vector_std = np.degrees(np.sqrt(np.diag(J @ C @ J.T)))
        if euler_deg is not None:
            step = np.eye(3) * _STEP_RAD
            ahead, behind = (
                np.array([se3.euler_zyx_deg(se3.exp_so3(sign * r) @ R) for r in step]) for sign in (1, -1)
            )
            J = ((ahead - behind + 180) % 360 - 180).T / (2 * _STEP_RAD)
            euler_std = np.sqrt(np.diag(J @ C @ J.T))
    return Rotation(vector_deg, vector_std, se3.quaternion_xyzw(R), euler_deg, euler_std, lock_deg)


def reference_std(solution: Solution) -> tuple[float | None, ...]:
    """Nine standard deviations for the reference camera, rad and m; None where the user fixed a parameter.

    Empty for methods that give none. With the left camera fixed, the pose of a right reference camera varies with the
    estimated stereo pair.
    """
    found = solution.uncertainty
    if found is None:
        return ()
    std = np.sqrt(np.diag(found.reference_covariance))
    return tuple(None if fixed and s == 0 else float(s) for s, fixed in zip(std, found.fixed, strict=True))


def predicted_point_rms_m(extraction: Extraction, solution: Solution) -> float:
    """Point error (square root of eq. 19) predicted from the noise of the triangulated corners alone, m."""
    traces = np.array([np.trace(o.points_cov, axis1=-2, axis2=-1).mean() for o in extraction.observations])
    legs = solution.residuals.legs
    return float(np.sqrt(np.mean(traces[legs].sum(axis=1)))) if len(legs) else 0.0


def board_distance_m(extraction: Extraction) -> float:
    """Median distance from the camera to the corners, m; 0 without observations."""
    seen = extraction.observations
    return float(np.median([np.linalg.norm(o.points_c, axis=-1).mean() for o in seen])) if seen else 0.0


def encoder_heading_rad(solution: Solution, extraction: Extraction) -> float:
    """Heading error if both encoders are off by one step, rad."""
    wheels = solution.parameters.wheels
    right, left = encoder_steps_rad(extraction.wheels).tolist()
    return float(wheels.radius_right_m * right + wheels.radius_left_m * left) / wheels.separation_m


def stations_looked_at(extraction: Extraction) -> int:
    """Number of stations found, whether used or rejected."""
    return max(extraction.counts.get("stations", 0), len(extraction.observations))


def rejected_station(rejection: Rejection, extraction: Extraction) -> str:
    """Station of a rejection, as "log:station" if there are several recordings; "" if it has none."""
    if rejection.station < 0:
        return ""
    return f"{rejection.log}:{rejection.station}" if len(extraction.wheels) > 1 else str(rejection.station)


def rejection_counts(extraction: Extraction) -> dict[tuple[str, str], int]:
    """Number of rejections for each (stage, reason), most frequent first."""
    counts: dict[tuple[str, str], int] = {}
    for item in extraction.rejections:
        counts[item.stage, item.reason] = counts.get((item.stage, item.reason), 0) + 1
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))


def image_coverage(pixels: FloatArray, width: int, height: int, cells: tuple[int, int] = (8, 6)) -> float:
    """Share of the cells of a coarse (across, down) image grid that contain a corner: (n, 2) → 0..1."""
    at = np.floor(pixels / [width, height] * cells).astype(int)
    inside = np.all((at >= 0) & (at < cells), axis=-1)
    return len(np.unique(at[inside], axis=0)) / (cells[0] * cells[1])


def station_names(extraction: Extraction) -> list[str]:
    """Name of each observation's station: its index, as "log:station" if there are several recordings."""
    several = len({o.log for o in extraction.observations}) > 1
    return [f"{o.log}:{o.station}" if several else str(o.station) for o in extraction.observations]
