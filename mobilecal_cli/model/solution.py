"""Results of the solvers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray, ReadOnly
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.findings import (
    AtWork,
    BetweenLogs,
    Budget,
    Diagnosis,
    EstimatedConstant,
    Evidence,
    Jump,
    ScaleCheck,
    Suggestion,
)
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import CameraRig

#: Standard deviation of what has no noise, rad, m, s.
EXACT = 1e-6
Method = Literal["linear", "paper", "lm", "ml"]
Setting: TypeAlias = "bool | int | float | str | Sequence[Setting] | Mapping[str, Setting] | None"


@dataclass(frozen=True, slots=True, eq=False)
class LinearEstimate(ReadOnly):
    """The iterative linear solution (paper, section 3).

    Attributes:
        parameters: the fixed point.
        history: the parameters after each iteration, the last equal to `parameters`; the iteration continues to the
            fixed point.
        rounds_to_tolerance: the iteration after which no parameter changed by more than 0.1 %, the paper's
            stopping rule.
        point_rms_m: square root of eq. 19 at `parameters`, m.
        start_ratios: (2,) wheel ratios (aR, aL) of the initial estimate.
        start_from: source of the initial estimate: "nominal" or "grid".
        rival_point_rms_m: square root of eq. 19 of the second-best solution, m; infinite (math.inf) if all initial
            estimates lead to the same solution.
    """

    parameters: Parameters
    history: tuple[Parameters, ...]
    rounds_to_tolerance: int
    point_rms_m: float
    start_ratios: Annotated[FloatArray, 2]
    start_from: str
    rival_point_rms_m: float

    @property
    def rounds(self) -> int:
        """Number of iterations."""
        return len(self.history)


@dataclass(frozen=True, slots=True, eq=False)
class Refinement(ReadOnly):
    """A nonlinear refinement of the linear solution.

    Attributes:
        method: "paper" (eq. 19 by Powell), "lm" (eq. 19 by Levenberg-Marquardt) or "ml" (maximum likelihood).
        parameters: at the minimum.
        point_rms_history_m: (n,) square root of eq. 19 at the start and after each iteration, m.
        point_rms_m: the last of them.
        evaluations: number of cost evaluations.
    """

    method: Method
    parameters: Parameters
    point_rms_history_m: Annotated[FloatArray, "n"]
    point_rms_m: float
    evaluations: int


def _level(guess: float, least: float, most: float) -> dict[str, float]:
    """Row of a noise level: a guess where nothing else is known, and limits.

    Beyond the largest, a level says that the model is wrong, not how noisy a measurement is.
    """
    return {"guess": guess, "least": least, "most": most}


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the measurements: one row for each noise level.

    The guesses are those of a good corner fit, wheels that roll on a firm floor, a servo's encoder, a tiled floor, and
    a base that hardly sways on its wheels.

    Attributes:
        pixel_px: of one corner coordinate (root mean square over the stations, whose images differ).
        wheel_rad_per_sqrt_rad: of a wheel's rotation over one radian; the variance grows with the rotation.
        encoder_rad: of one encoder reading of the wheel with the coarser encoder; 0 where the encoders have no steps.
        joint_rad: of one reading of a revolute joint; of a prismatic one in units of 0.1 m.
        floor_rad, floor_m: of the floor's roll and pitch under the base, and of its height.
        stamp_s: of an image's time stamp, where the robot moves.
        pair_s: of the time between the images of two cameras there, beside their mean delay.
        shift_px: of each image as a whole, along each axis, where there are several cameras.
        wheel_share: of each wheel's scale.
        floor_length_m, wheel_length_m: driven distance over which floor and wheel scales stay alike.
        sway_rad, sway_m: of the base's roll and pitch, and of its height, at each station beside the floor's.
        pose_scale: of measured poses, in units of the stated standard deviations.
        wider: kind of constants → how many times as wide as stated their priors are, at least 1.
    """

    pixel_px: float = field(metadata=_level(0.1, 1e-3, 1e3))
    wheel_rad_per_sqrt_rad: float = field(metadata=_level(0.004, 1e-5, 1.0))
    encoder_rad: float = field(metadata=_level(0.0, 0.0, 1.0))
    joint_rad: float = field(metadata=_level(math.radians(0.03), 1e-6, 1.0))
    floor_rad: float = field(metadata=_level(math.radians(0.1), 1e-6, 0.1))
    floor_m: float = field(metadata=_level(0.0005, 1e-6, 0.1))
    stamp_s: float = field(metadata=_level(0.0005, 1e-6, 0.1))
    pair_s: float = field(metadata=_level(0.0001, 1e-6, 0.1))
    shift_px: float = field(metadata=_level(0.02, 1e-4, 3.0))
    wheel_share: float = field(metadata=_level(0.001, 1e-6, 0.1))
    floor_length_m: float = field(metadata=_level(0.3, 1e-3, 1e3))
    wheel_length_m: float = field(metadata=_level(1.0, 1e-3, 1e3))
    sway_rad: float = field(metadata=_level(math.radians(0.02), 1e-6, 0.1))
    sway_m: float = field(metadata=_level(0.0001, 1e-6, 0.1))
    pose_scale: float = field(metadata=_level(1.0, 1e-3, 1e3))
    wider: Mapping[str, float]

    @classmethod
    def limits(cls, of: Literal["guess", "least", "most"]) -> dict[str, float]:
        """Name → guess or limit of each level."""
        return {each.name: each.metadata[of] for each in fields(cls) if of in each.metadata}

    @classmethod
    def exact(cls, **levels: float) -> Noise:
        """Some levels, the others of measurements without noise."""
        known = {"encoder_rad": 0.0, "floor_length_m": 0.3, "wheel_length_m": 1.0, "pose_scale": 1.0}
        return cls(**{**dict.fromkeys(cls.limits("guess"), EXACT), **known, **levels}, wider={})

    @property
    def levels(self) -> dict[str, float]:
        """Name → level of each kind of measurement."""
        return {name: getattr(self, name) for name in Noise.limits("guess")}

    @property
    def all_levels(self) -> dict[str, float]:
        """`levels` and `wider`."""
        return self.levels | dict(self.wider)

    def with_levels(self, changed: Mapping[str, float]) -> Noise:
        """With some of `all_levels` changed."""
        names = Noise.limits("guess").keys()
        own = {name: level for name, level in changed.items() if name in names}
        others = {name: factor for name, factor in changed.items() if name not in names}
        return replace(self, **own, wider={**self.wider, **others})


@dataclass(frozen=True, slots=True)
class NoiseLevels(Noise):
    """Standard deviations of the measurements.

    Attributes:
        estimated: names of the levels that were estimated from the residuals; the others were given.
        redundancy: estimated level → number of redundant residuals.
    """

    estimated: tuple[str, ...]
    redundancy: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty(ReadOnly):
    """Uncertainty of the nine parameters.

    Attributes:
        covariance: (9, 9) in the order of `NINE`, see `Parameters` (rad, m): the inverse of the normal matrix
            (Cramer-Rao bound), plus the prior variance of unobservable directions, widened by `widened`.
        reference_covariance: (9, 9) the same with the pose of the reference camera, which also depends on the
            estimated stereo pair.
        observable: (9,) whether the recording makes the standard deviation clearly smaller than that of a nominal
            value; false for fixed parameters.
        unobservable: (K, 9) directions that the recording does not show, in units of `scales`, unit length: the
            parameters keep their nominal values along them, and the prior variance.
        scales: (9,) prior standard deviations of nominal values, rad, m.
        singular_values: of the whitened, scaled Jacobian, decreasing: scale over sigma along each direction.
        noise: noise levels.
        fixed: (9,) parameters fixed by the user; their variance is zero.
        jackknife_std: (9,) standard deviations from leaving out stations and legs in turn, with the pose of the
            reference camera, for comparison.
        described: (9,) unobservable parameters that no motion of this robot shows: the height of a camera that never
            tilts. They are as described, or as the user's prior says; expected errors at work and the budget are about
            all else.
        widened: (9,) factor on each standard deviation: above 1 where the jackknife is clearly larger.
        at_work: expected errors at work.
        camera: (6 + K, 6 + K) covariance of the first camera's pose in the base, right twist (rotation, then
            translation; mean over the head's poses), and of the `camera_constants`, K names.
        budget: what limits the accuracy.
        asked: options with which the user fixed a parameter or constant, or stated its prior ("--fix t_x"), or narrower
            priors in rig.yaml ("priors.pan_zero"), each alone or all together → distance of the data from what is
            asked, and the largest change of the nine without any, both in standard deviations.
        with_prior: (9,) parameters whose prior the user stated.
    """

    covariance: Annotated[FloatArray, 9, 9]
    reference_covariance: Annotated[FloatArray, 9, 9]
    observable: Annotated[BoolArray, 9]
    unobservable: Annotated[FloatArray, "K", 9]
    scales: Annotated[FloatArray, 9]
    singular_values: Annotated[FloatArray, "D"]
    noise: NoiseLevels
    fixed: Annotated[BoolArray, 9]
    jackknife_std: Annotated[FloatArray, 9]
    described: Annotated[BoolArray, 9]
    widened: Annotated[FloatArray, 9]
    at_work: AtWork
    camera: Annotated[FloatArray, "C", "C"]
    camera_constants: tuple[str, ...]
    budget: Budget
    asked: Mapping[tuple[str, ...], tuple[float, float]] = field(default_factory=dict)
    with_prior: Annotated[BoolArray, 9] = field(default_factory=lambda: np.zeros(9, dtype=np.bool_))

    @property
    def std(self) -> FloatArray:
        """Standard deviations, (9,), rad and m; 0 for fixed parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, slots=True)
class Outlier:
    """A measurement that is inconsistent with the others and not used in the estimate.

    Attributes:
        kind: "corners", "station", "slip" or "joint".
        log: index of the recording.
        observations: the observation, or the two around a slip.
        time_ns: its time.
        text: a whole sentence with the numbers.
    """

    kind: Literal["corners", "station", "slip", "joint"]
    log: int
    observations: tuple[int, ...]
    time_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Residuals(ReadOnly):
    """Residuals of the parameters, in the order of `Extraction.observations`.

    For each leg, the parameters predict the corners of its second station in its first station (eq. 18).

    Attributes:
        legs: (L, 2) indices of the two observations of each leg.
        leg_point_rms_m: (L,) square root of eq. 19 of that leg alone, m.
        leg_corner_noise_m: (L,) what the noise of the triangulated corners alone makes of it, m.
        predicted_px: (C, L, M, 2) predicted corners projected into the first station's images, px.
        leg_reprojection_px: (L,) rms distance to the detected corners, both cameras, px.
        T_w_v: (N, 4, 4) base in the world (the base at the recording's first observation), by dead reckoning.
        T_w_c: (N, 4, 4) first camera in the world, by the base and the head with its estimated constants.
        T_w_k: (N, 4, 4) board in the world as each observation measures it.
    """

    legs: Annotated[IntArray, "L", 2]
    leg_point_rms_m: Annotated[FloatArray, "L"]
    leg_corner_noise_m: Annotated[FloatArray, "L"]
    predicted_px: Annotated[FloatArray, "C", "L", "M", 2]
    leg_reprojection_px: Annotated[FloatArray, "L"]
    T_w_v: Annotated[FloatArray, "N", 4, 4]
    T_w_c: Annotated[FloatArray, "N", 4, 4]
    T_w_k: Annotated[FloatArray, "N", 4, 4]

    @property
    def corner_noise_m(self) -> float:
        """Point error over all legs that the noise of the triangulated corners alone makes, m."""
        return math.sqrt(float(np.mean(self.leg_corner_noise_m**2))) if len(self.legs) else 0.0


class ErrorPart(NamedTuple):
    """The error that one kind of noise alone causes, rms over the legs: in the images of a camera and in space."""

    px: float
    m: float


def largest_mean_square(count: int) -> float:
    """Mean square of normal errors over the expected one, three standard deviations above it: of so many errors."""
    return 1 + 3 * math.sqrt(2 / count)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The result of a calibration.

    Attributes:
        method: method of `parameters`.
        parameters: the nine parameters.
        cameras: the stereo pair as estimated; as stated for methods that do not estimate it.
        linear: the linear solution.
        refinement: None for the method "linear".
        residuals: at `parameters`.
        point_rms_m: square root of eq. 19 at `parameters`, m.
        reprojection_rms_px: rms distance between predicted and detected corners over all legs, px.
        error_parts: what each kind of noise ("corners", or "poses" if these were measured, "joints", "floor",
            "wheels", and "stamps" in motion), "lenses" beside their models and "turns" that differ (or a wheel that is
            late) contribute to both errors; empty where the noise levels are not estimated.
        leg_noise: (2, L) rms error of each leg of the residuals that all noise levels together explain, px and m; None
            where they are not estimated.
        motion: extent of the motion: "pan_range_deg", "tilt_range_deg", "turned_deg", "driven_m", ...
        uncertainty: None for methods that give none.
        outliers: measurements not used in the maximum-likelihood estimate.
        noisy: kinds of measurements ("views", "legs", "readings") whose many outliers were taken as noise.
        constants: the constants of the robot description, by name.
        evidence: how far the data contradict the stated constants, for each kind and part.
        contradictions: stated constants that the data contradict, most significant first; each was found with wider
            priors of those before it, and the solution has wider priors of all of them.
        scale: stated squares against the stereo baseline, if the square size is stated.
        between: estimates from each recording alone, if there are several.
        jumps: moments at which something moved.
        suggestions: what to record next, most useful first.
        diagnosis: the mistake in the description that explains a bad fit, if one was found.
    """

    method: Method
    parameters: Parameters
    cameras: CameraRig
    linear: LinearEstimate
    refinement: Refinement | None
    residuals: Residuals
    point_rms_m: float
    reprojection_rms_px: float
    motion: Mapping[str, float]
    error_parts: Mapping[str, ErrorPart] = field(default_factory=dict)
    leg_noise: FloatArray | None = None
    uncertainty: Uncertainty | None = None
    outliers: tuple[Outlier, ...] = ()
    noisy: tuple[str, ...] = ()
    constants: Mapping[str, EstimatedConstant] = field(default_factory=dict)
    evidence: tuple[Evidence, ...] = ()
    contradictions: tuple[Evidence, ...] = ()
    scale: ScaleCheck | None = None
    between: BetweenLogs | None = None
    jumps: tuple[Jump, ...] = ()
    suggestions: tuple[Suggestion, ...] = ()
    diagnosis: Diagnosis | None = None

    def __repr__(self) -> str:
        """One line."""
        errors = f"point error {1e3 * self.point_rms_m:.3g} mm, {self.reprojection_rms_px:.3g} px"
        return f"Solution({self.method!r}, {errors}, {len(self.outliers)} outliers)"

    @property
    def T_h_reference(self) -> FloatArray:
        """Head-eye transform of the reference camera, (4, 4): camera coordinates to head coordinates, m."""
        T: FloatArray = self.parameters.T_h_c @ self.cameras.T_c_reference
        return T

    @property
    def gross_outliers(self) -> tuple[Outlier, ...]:
        """The outliers but single corners: stations, legs and joint readings."""
        return tuple(outlier for outlier in self.outliers if outlier.kind != "corners")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Provenance of the outputs.

    Attributes:
        version: version of mobilecal.
        created: time, ISO 8601 in UTC ("2015-06-01T12:00:00Z").
        method: requested method, see `Solution.method`.
        logs: the recordings.
        config: the settings used, nested by section, and the source of each.
    """

    version: str
    created: str
    method: str
    logs: tuple[LogSource, ...]
    config: Mapping[str, Setting]


@dataclass(frozen=True, slots=True)
class Drift:
    """Relative error of dead reckoning against the cameras, over all pairs of stations of a log.

    Attributes:
        mm_per_m: rms position error over the rms path length; None if the base hardly drove.
        deg_per_turn: rms heading error over the rms rotation, for a full turn; None if the base hardly turned.
    """

    mm_per_m: float | None
    deg_per_turn: float | None


#: A larger corner error of an evaluation counts as this, px, as does a corner predicted behind the camera.
MOST_ERROR_PX = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation(ReadOnly):
    """Errors of a calibration on a recording.

    The parameters predict the camera motion over each leg (eq. 18); the board gives the measured motion.

    Attributes:
        stations: number of stations with the board in both cameras.
        legs: (L, 3) log, first and second station of each leg.
        reprojection_px: (L,) rms distance of transferred to detected corners, both cameras; `MOST_ERROR_PX` at most.
        rotation_rad: (L,) angle between predicted and measured camera rotation.
        translation_m: (L,) distance between predicted and measured camera position.
        driven_m, turned_rad: path length and absolute rotation, summed over the legs.
        before: drift with the wheels to compare with, None if there are none.
        after: drift with the calibrated wheels.
        clock_offsets_s: estimated clock offset of "joints" and "wheels", s, and of further recordings against these;
            empty if not estimated.
    """

    stations: int
    legs: Annotated[IntArray, "L", 3]
    reprojection_px: Annotated[FloatArray, "L"]
    rotation_rad: Annotated[FloatArray, "L"]
    translation_m: Annotated[FloatArray, "L"]
    driven_m: float
    turned_rad: float
    before: Drift | None
    after: Drift
    clock_offsets_s: Mapping[str, float] = field(default_factory=dict)
