"""What was solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray, freeze
from mobilecal_cli.model.findings import BetweenLogs, Evidence, ScaleCheck, Suggestion
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import WheelGeometry

Method = Literal["linear", "paper", "lm", "ml"]
NINE = ("r_x", "r_y", "r_z", "t_x", "t_y", "t_z", "radius_right", "radius_left", "separation")
Setting: TypeAlias = "bool | int | float | str | Sequence[Setting] | Mapping[str, Setting] | None"


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """The nine numbers.

    Attributes:
        T_h_c: (4, 4) head-eye transform: left camera coordinates to head coordinates, m.
        wheels: radii and separation.
    """

    T_h_c: FloatArray
    wheels: WheelGeometry

    def __post_init__(self) -> None:
        freeze(self, T_h_c=(4, 4))


@dataclass(frozen=True, slots=True, eq=False)
class LinearEstimate:
    """The iterative linear solution (paper, section 3).

    Attributes:
        parameters: the fixed point.
        history: the parameters after each round, the last equal to `parameters`; the rounds go on to the
            fixed point.
        rounds_to_tolerance: the round after which no parameter had moved by more than 0.1 %, the paper's
            own end.
        point_rms_m: square root of eq. 19 at `parameters`, m.
        start_ratios: (2,) wheel ratios (aR, aL) of the start that was kept.
        start_from: where that start came from: "nominal", "given" or "grid".
        rival_point_rms_m: square root of eq. 19 of the best answer that differs from the kept one, m;
            infinite (math.inf) when every start ended at the same answer.
    """

    parameters: Parameters
    history: tuple[Parameters, ...]
    rounds_to_tolerance: int
    point_rms_m: float
    start_ratios: FloatArray
    start_from: str
    rival_point_rms_m: float

    def __post_init__(self) -> None:
        freeze(self, start_ratios=(2,))

    @property
    def rounds(self) -> int:
        """How many rounds the iteration took."""
        return len(self.history)


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A nonlinear refinement of the linear solution.

    Attributes:
        method: "paper" (eq. 19 by Powell), "lm" (eq. 19 by Levenberg-Marquardt) or "ml" (maximum likelihood).
        parameters: at the minimum.
        point_rms_history_m: (n,) square root of eq. 19 after each iteration, from the start on, m.
        point_rms_m: the last of them.
        evaluations: how often the cost was evaluated.
    """

    method: Method
    parameters: Parameters
    point_rms_history_m: FloatArray
    point_rms_m: float
    evaluations: int

    def __post_init__(self) -> None:
        freeze(self, point_rms_history_m=("n",))


@dataclass(frozen=True, slots=True)
class NoiseLevels:
    """Standard deviations of the measurements.

    Attributes:
        pixel_px: of one corner coordinate.
        wheel_rad_per_sqrt_rad: of a wheel's rotation over one radian; the variance grows with the rotation.
        encoder_rad: of one encoder reading; 0 where the encoders have no steps.
        joint_rad: of one joint reading.
        estimated: names of the levels that come from the residuals; the others were given.
        redundancy: estimated level → how many residuals it rests on.
    """

    pixel_px: float
    wheel_rad_per_sqrt_rad: float
    encoder_rad: float
    joint_rad: float
    estimated: tuple[str, ...]
    redundancy: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """How well the nine numbers are known: the inverse of the normal matrix (Cramer-Rao bound).

    Attributes:
        covariance: (9, 9) in the order of `NINE`: small rotation vector and translation of the left camera in the
            head's frame (rad, m), wheels (m). Held directions have none.
        observable: (9,) false for numbers that a plausible error of what is held would shift by more than their
            own sigma: they are as good as the nominal value, and `covariance` does not speak of them.
        held: (K, 9) held directions, in units of `scales`, unit length.
        scales: (9,) rad, m.
        singular_values: falling, of the whitened, scaled Jacobian: scale over sigma along each direction.
        noise: levels.
        fixed: (9,) numbers that the user fixed; not observable either.
        jackknife_std: (9,) standard deviations by leaving out stations and legs in turn: a second opinion.
    """

    covariance: FloatArray
    observable: BoolArray
    held: FloatArray
    scales: FloatArray
    singular_values: FloatArray
    noise: NoiseLevels
    fixed: BoolArray
    jackknife_std: FloatArray

    def __post_init__(self) -> None:
        freeze(
            self, covariance=(9, 9), held=("K", 9), scales=(9,), singular_values=("D",), jackknife_std=(9,)
        )
        freeze(self, np.bool_, observable=(9,), fixed=(9,))

    @property
    def std(self) -> FloatArray:
        """(9,) standard deviations, rad and m; 0 in held directions."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def referred(self, T_h_c: FloatArray, T_c_reference: FloatArray) -> FloatArray:
        """(9, 9) covariance of the reference camera's numbers: its position also moves with the rotation."""
        J = np.eye(9)
        J[3:6, :3] = np.cross(np.eye(3), T_h_c[:3, :3] @ T_c_reference[:3, 3]).T
        C: FloatArray = J @ self.covariance @ J.T
        return C


@dataclass(frozen=True, slots=True)
class Outlier:
    """A measurement that does not belong, and was left out.

    Attributes:
        kind: "corners", "station", "slip" or "joint".
        log: index of the recording.
        observations: the observation, or the two that a slip lies between.
        time_ns: when.
        text: a whole sentence with the numbers.
    """

    kind: Literal["corners", "station", "slip", "joint"]
    log: int
    observations: tuple[int, ...]
    time_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """How well the parameters explain each observation, in the order of `Extraction.observations`.

    Each leg carries the corners of its second station into its first by the parameters alone (eq. 18).

    Attributes:
        legs: (L, 2) indices of the two observations of each leg.
        leg_point_rms_m: (L,) square root of eq. 19 of that leg alone, m.
        predicted_left_px, predicted_right_px: (L, M, 2) those carried corners projected into the first
            station's pictures, px.
        leg_reprojection_px: (L,) rms distance to the detected corners, both cameras, px.
        T_w_v: (N, 4, 4) base in the world (the base at the log's first observation), by dead reckoning.
        T_w_k: (N, 4, 4) board in the world as each observation sees it.
    """

    legs: IntArray
    leg_point_rms_m: FloatArray
    predicted_left_px: FloatArray
    predicted_right_px: FloatArray
    leg_reprojection_px: FloatArray
    T_w_v: FloatArray
    T_w_k: FloatArray

    def __post_init__(self) -> None:
        legs = freeze(self, np.int64, legs=("L", 2))["L"]
        freeze(
            self,
            leg_point_rms_m=(legs,),
            predicted_left_px=(legs, "M", 2),
            predicted_right_px=(legs, "M", 2),
            leg_reprojection_px=(legs,),
            T_w_v=("N", 4, 4),
            T_w_k=("N", 4, 4),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The answer.

    Attributes:
        method: what `parameters` come from.
        parameters: the nine numbers.
        linear: the linear estimate they started from.
        refinement: None for the method "linear".
        residuals: at `parameters`.
        point_rms_m: square root of eq. 19 at `parameters`, m.
        reprojection_rms_px: rms distance of carried to detected corners over all legs, px.
        motion: what the log's motion was: "pan_range_deg", "tilt_range_deg", "turned_deg", "driven_m", ...
        uncertainty: of the nine numbers; None for the methods that know none.
        outliers: what was left out of the maximum-likelihood estimate.
        extras: what was estimated beside the nine: name → value and standard deviation.
        evidence: whether the log supports more numbers than the nine.
        scale: the board's squares against the stereo baseline, where their size is stated.
        between: the logs one by one, where there are several.
        suggestions: what to record next, the best first.
    """

    method: Method
    parameters: Parameters
    linear: LinearEstimate
    refinement: Refinement | None
    residuals: Residuals
    point_rms_m: float
    reprojection_rms_px: float
    motion: Mapping[str, float]
    uncertainty: Uncertainty | None = None
    outliers: tuple[Outlier, ...] = ()
    extras: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    evidence: tuple[Evidence, ...] = ()
    scale: ScaleCheck | None = None
    between: BetweenLogs | None = None
    suggestions: tuple[Suggestion, ...] = ()


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where the outputs come from.

    Attributes:
        version: of mobilecal.
        created: when, ISO 8601 in UTC ("2015-06-01T12:00:00Z").
        method: what was asked for, see `Solution.method`.
        logs: the recordings.
        config: the settings in force, nested by section; beside each, what settled it.
    """

    version: str
    created: str
    method: str
    logs: tuple[LogSource, ...]
    config: Mapping[str, Setting]
