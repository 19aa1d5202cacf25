"""Results beyond the nine parameters: model comparison, scale check, single recordings, suggestions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from mobilecal_cli.model.arrays import BoolArray, FloatArray, ReadOnly

#: Data that contradict stated constants by more than this are evidence of a wrong description.
CONTRADICTION_SIGMAS = 4.0
#: What moves the result by less does not matter: for example the cameras of a pair that warms up.
MATERIAL_SIGMAS = 2.0
#: Largest noise of wheels that is no fault, rad per sqrt(rad): twice that of usual floors.
WHEEL_NOISE = 0.03
#: Largest noise of an image's time stamp that is no fault.
STAMP_NOISE_S = 0.02
_LONGEST_DELAY_S = (
    0.025  # of a camera against the first one, as rates correct it: those of 20 ms are within 3 sigma
)


@dataclass(frozen=True, slots=True)
class EstimatedConstant:
    """A constant of the robot description, as estimated: its difference from the stated value.

    Attributes:
        name, kind, part, meaning: see `likelihood.constants.Constant`.
        value, std: estimate and standard deviation, in the unit of the kind.
        prior: standard deviation of the stated value; 0 where it is exact.
    """

    name: str
    kind: str
    part: str
    meaning: str
    value: float
    std: float
    prior: float


@dataclass(frozen=True, slots=True)
class EvidenceValue:
    """A constant without its prior.

    Attributes:
        value, std: estimate and standard deviation, None where the data do not show it.
        prior: standard deviation of the stated value.
    """

    value: float
    std: float | None
    prior: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """How far the data contradict the stated values of one kind of constants of one part.

    Attributes:
        kind, part: which constants, see `likelihood.constants.Constant`.
        values: name → estimate without the priors of these constants.
        chi2: decrease of the cost if the stated values of these constants were ignored, to second order.
        sigmas: `chi2` as a number of standard deviations of a normal distribution.
        shift_sigmas: largest change of one of the nine parameters if they were ignored, in its standard deviations.
        asked: those of them whose stated value is that of --prior, not of the description.
    """

    kind: str
    part: str
    values: Mapping[str, EvidenceValue]
    chi2: float
    sigmas: float
    shift_sigmas: float
    asked: tuple[str, ...] = ()

    @property
    def late_camera(self) -> bool:
        """Whether a camera is so late, or early, that no rates around its stamps correct it at each change of speed."""
        late_s = max(abs(each.value) for each in self.values.values())
        return self.kind == "stereo_clock" and late_s > _LONGEST_DELAY_S


@dataclass(frozen=True, slots=True)
class AtWork:
    """Expected errors (standard deviations) when the calibration is used.

    Attributes:
        camera_m, camera_rad: position and rotation of the first camera in the base over all directions, root mean
            square over the head's poses in the recording, with the estimated constants of the head applied; without
            estimated constants: on the head.
        point_m: position of a point two meters ahead of the camera, the same way.
        along_m_per_m, heading_rad_per_m: distance and heading by dead reckoning in straight driving.
        sideways_m_per_m: sideways position after one meter of straight driving.
        heading_rad_per_turn: heading per full turn in place.
    """

    camera_m: float
    camera_rad: float
    point_m: float
    along_m_per_m: float
    heading_rad_per_m: float
    sideways_m_per_m: float
    heading_rad_per_turn: float


@dataclass(frozen=True, slots=True, eq=False)
class Budget(ReadOnly):
    """What the variances come from. The shares of each column add up to 1.

    Attributes:
        sources: noise levels (see `Noise`), kinds of constants (see `likelihood.constants.KINDS`), and
            "nominal", "unobservable", "other".
        nine: (S, 9) shares of the nine parameters, 0 for fixed ones.
        at_work: field of `AtWork` → (S,) shares.
    """

    sources: tuple[str, ...]
    nine: Annotated[FloatArray, "S", 9]
    at_work: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class ScaleCheck:
    """Consistency of the two references for scale: the stated squares and the stereo baseline.

    Attributes:
        ratio: size of the squares as measured with the baseline, over their stated size.
        std: standard deviation of the ratio.
        square_m, baseline_m: as stated.
        apart: the ratio differs from 1 significantly; the solution then uses the baseline for scale.
    """

    ratio: float
    std: float
    square_m: float
    baseline_m: float
    apart: bool


@dataclass(frozen=True, slots=True, eq=False)
class BetweenLogs(ReadOnly):
    """Estimates from each of several recordings alone.

    Attributes:
        shift: (L, 9) each recording's own estimate minus the common one, order and units of `NINE`; 0 where a
            parameter is unobservable in a recording.
        std: (L, 9) their standard deviations; 0 where a parameter is unobservable.
        shown: (L, 9) whether the parameter is observable in the recording.
        between_std: (9,) additional spread between the recordings; 0 where none is significant.
    """

    shift: Annotated[FloatArray, "L", 9]
    std: Annotated[FloatArray, "L", 9]
    shown: Annotated[BoolArray, "L", 9]
    between_std: Annotated[FloatArray, 9]


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion(ReadOnly):
    """An additional stop at the end of the recording, and the expected improvement.

    Attributes:
        turn_rad, drive_m, face_rad: motion of the base: a turn (left is positive), the drive, and another turn.
        joints: (J,) head joint values, rad or m.
        worst: the least certain parameter relative to what a robot needs.
        std_now, std_then: its standard deviation without and with the stop, rad or m.
        gain: relative decrease of the largest standard deviation over all nine.
    """

    turn_rad: float
    drive_m: float
    face_rad: float
    joints: Annotated[FloatArray, "J"]
    worst: str
    std_now: float
    std_then: float
    gain: float


@dataclass(frozen=True, slots=True)
class Jump:
    """A moment from which on a part of the robot, or the board, is not where it was before, or in other recordings.

    Attributes:
        part: "head mount", "joint <name>", "board", "lean of the base", "<name> camera", "focal length of the <name>
            camera", "right wheel" or "left wheel", or "both wheels", "board's size" or "board's shape" in another
            recording; "" if unknown.
        log: index of the recording.
        station: index of the first observation after it; the first of a recording that differs from the others.
        time_ns: its time.
        rejected: stations whose images, and legs whose wheels, are not used around it; (0, 0) if it is explained.
        sigmas: its significance; infinite (math.inf) where some are rejected.
        shift_sigmas: how far it moves the result, or is itself, in standard deviations of the nine parameters.
        turn_rad, move_m: its size; 0 where it has no such part. Of a wheel: change of the radius, of both: the
            larger one.
        also: another part that explains the recording about as well, and moves the result less; "" if none does.
        share: relative change of a focal length, the largest; 0 for other parts.
    """

    part: str
    log: int
    station: int
    time_ns: int
    rejected: tuple[int, int]
    sigmas: float
    shift_sigmas: float
    turn_rad: float
    move_m: float
    also: str = ""
    share: float = 0.0


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A mistake in the robot's description that explains why a recording does not fit.

    Attributes:
        cause: what is wrong, as the end of a sentence.
        cure: what to do, as a command.
        error_share: point error over the distance to the board as the recording stands; None if there is no solution.
        corrected_share: the same without the mistake; None if it was not computed.
    """

    cause: str
    cure: str
    error_share: float | None = None
    corrected_share: float | None = None
