"""The expected errors when the calibration is used: their limits, what they come from, and what reduces them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mobilecal_cli.likelihood.constants import FREED_SIGMAS, family, kind_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import AtWork, Budget
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.solution import Solution
from mobilecal_cli.ranges import ACCURACY, accuracy
from mobilecal_cli.report.numbers import DEG, std_text


@dataclass(frozen=True, slots=True)
class Figure:
    """One expected error in use.

    Attributes:
        field: of `AtWork`.
        name: of its gate, see `Metric`.
        meaning, short: label, and the one in a chart.
        unit: for people.
        factor: how many of it one unit of the field is.
    """

    field: str
    name: str
    meaning: str
    short: str
    unit: str
    factor: float

    @property
    def limit(self) -> float | None:
        """Default limit in this unit, for robots of usual size; None for no limit."""
        return ACCURACY.get(self.name)

    @property
    def of_camera(self) -> bool:
        """Whether it is of the camera, and not of dead reckoning."""
        return self.field in ("camera_m", "camera_rad", "point_m")

    def of(self, expected: AtWork) -> float:
        """The figure in its unit."""
        return float(getattr(expected, self.field)) * self.factor


# fmt: off
FIGURES = (
    Figure("camera_m", "predicted.camera_mm", "camera position in the base", "camera position", "mm", 1e3),
    Figure("camera_rad", "predicted.camera_deg", "camera rotation in the base", "camera rotation", "deg", DEG),
    Figure("point_m", "predicted.point_mm", "point 2 m in front of the camera", "point", "mm", 1e3),
    Figure("along_m_per_m", "predicted.along_mm_per_m", "distance by dead reckoning, driving straight",
           "distance per meter", "mm/m", 1e3),
    Figure("sideways_m_per_m", "predicted.sideways_mm_per_m", "lateral position by dead reckoning after one meter",
           "lateral position per meter", "mm/m", 1e3),
    Figure("heading_rad_per_m", "predicted.heading_deg_per_m", "heading by dead reckoning, driving straight",
           "heading per meter", "deg/m", DEG),
    Figure("heading_rad_per_turn", "predicted.heading_deg_per_turn", "heading by dead reckoning per full turn",
           "heading per turn", "deg", DEG),
)
# fmt: on


@dataclass(frozen=True, slots=True)
class Error:
    """An error (1 sigma) and its limit, in the unit of the figure, and its (share, source), largest first."""

    figure: Figure
    value: float
    limit: float
    shares: Sequence[tuple[float, str]]

    @property
    def share(self) -> float:
        """Error over limit."""
        return self.value / self.limit if self.limit > 0 else math.inf if self.value > 0 else 0.0

    @property
    def limiting(self) -> str:
        """Which group of sources contributes most to it, as a sentence; "" where that is unknown."""
        for share, group in family_shares(self.shares):
            return f"{FAMILIES[group].limits} the {self.figure.meaning}: {100 * share:.0f} % of its variance."
        return ""


def uses(solution: Solution, limits: Mapping[str, float]) -> tuple[Error, ...]:
    """All expected errors that have a limit, the default or that of a gate in `limits`; none without deviations."""
    uncertainty = solution.uncertainty
    if uncertainty is None:
        return ()
    separation_m = solution.parameters.wheels.separation_m
    pairs = [(figure, limits.get(figure.name, accuracy(figure.name, separation_m))) for figure in FIGURES]
    return tuple(
        Error(f, f.of(uncertainty.at_work), limit, shares_of(uncertainty.budget, f.field))
        for f, limit in pairs
        if limit is not None
    )


#: A cure that improves the least certain expected error by less is not worth a sentence.
LEAST_GAIN = 0.05
#: Stated values are taken to be measured this many times better, if the user measures them again.
_BETTER = 2.0
_MOST_TIMES = 4  # times as many; more are not practical


class Cure(NamedTuple):
    """What to do about an error, and the share of its variance that this removes, to first order."""

    command: str
    removed: float

    def text(self, error: Error) -> str:
        """The command and what it gives, as a sentence."""
        then = f"{std_text(error.value)} to {std_text(error.value * self.left)} {error.figure.unit}"
        return f"{self.command}: the {error.figure.meaning} improves from {then}."

    @property
    def left(self) -> float:
        """The error afterwards, as a share of what it is."""
        return math.sqrt(max(1 - self.removed, 0.0))


def freed_kinds(solution: Solution) -> set[str]:
    """Kinds of constants whose stated values the user has the estimate ignore."""
    # Priors that the data ask to be wider are not the user's.
    widths = {} if solution.uncertainty is None else solution.uncertainty.noise.wider
    return {
        c.kind
        for c in solution.constants.values()
        if c.prior >= FREED_SIGMAS * kind_of(c.kind).sigma * widths.get(family(c.kind), 1.0)
    }


def cures_of(error: Error, solution: Solution, extraction: Extraction) -> tuple[Cure, ...]:
    """What improves an error by 5 % or more, the cheapest first."""
    of = {name: share for share, name in error.shares}
    cures = []
    scale, measured = solution.constants.get("baseline_scale"), {"baseline_length", "square_size"}
    unstated = extraction.board.square_m is None and scale is not None and scale.std > 0
    if unstated and scale is not None:
        ratio = kind_of("square_size").sigma / scale.std
        removed = sum(of.get(name, 0.0) for name in measured) / (1 + ratio**2)
        cures.append(Cure("Measure the squares, and state board.square_m in rig.yaml", removed))
    other = [name for name in of if name in STATED and not (unstated and name in measured)]
    if other:
        stated = max(other, key=lambda name: of[name])
        command = f"{STATED[stated].advice}, and state half of `priors: {stated}` in rig.yaml"
        removed = of[stated] * (1 - 1 / _BETTER**2)
        if stated in freed_kinds(solution):
            command = f"Leave out --estimate {stated}, or `priors: {stated}: free` in rig.yaml"
            removed = of[stated]
        cures.append(Cure(command, removed))
    differ = (
        "Calibrate each recording alone, and check that all are of one robot on which nothing was changed"
    )
    cures.append(Cure(differ, of.get("recordings", 0.0)))
    noise = sum(
        share for share, name in error.shares if name not in STATED and family_of(name) not in _NOT_NOISE
    )
    alone = (error.limit / error.value) ** 2 - (1 - noise) if error.value > 0 else 1.0
    with_others = alone + sum(cure.removed for cure in cures)
    needed = (math.ceil(noise / room) for room in (alone, with_others) if room > 0)
    times = next((max(2, times) for times in needed if times <= _MOST_TIMES), _MOST_TIMES)
    words = {2: "twice", 3: "three times", 4: "four times"}
    cures.append(Cure(f"Record {words[times]} as many stops", noise * (1 - 1 / times)))
    return tuple(cure for cure in cures if 1 - cure.left >= LEAST_GAIN)


def next_step_of(error: Error, solution: Solution, extraction: Extraction) -> str:
    """The cheapest cure that brings an error within its limit; if none does alone, all."""
    cures = cures_of(error, solution, extraction)
    for cure in cures:
        if cure.left * error.value <= error.limit:
            return cure.text(error)
    if not cures:
        return "Record again with more stops, head motion and turns."
    first, *others = (cure.command for cure in cures)
    command = "; ".join((first, *(f"{other[0].lower()}{other[1:]}" for other in others)))
    return Cure(command, sum(cure.removed for cure in cures)).text(error)


def worst_error(solution: Solution, limits: Mapping[str, float]) -> Error | None:
    """The expected error that is nearest to its limit, or furthest beyond; None where nothing is known."""
    worst = max(uses(solution, limits), key=lambda use: use.share, default=None)
    return worst if worst is not None and worst.share > 0 else None


#: Families that more stops of the same kind do not reduce.
_NOT_NOISE = frozenset({"nominal values", "recordings", "other"})


def shares_of(budget: Budget, name: str) -> Sequence[tuple[float, str]]:
    """(share, source) of a parameter, or of an expected error (field of `AtWork`), largest first; empty if unknown."""
    columns = {**dict(zip(NINE, budget.nine.T, strict=True)), **budget.at_work}
    pairs = zip(columns[name].tolist(), budget.sources, strict=True) if name in columns else ()
    return sorted(((share, source) for share, source in pairs if share > 0), reverse=True)


def use_sentence(solution: Solution, limits: Mapping[str, float]) -> str:
    """The expected errors that have a limit, in one sentence, and whose limits they are."""
    errors = uses(solution, limits)
    groups: dict[str, list[str]] = {"camera": [], "dead reckoning": []}
    for figure, value in ((error.figure, error.value) for error in errors if error.value):
        group = "camera" if figure.of_camera else "dead reckoning"
        turn = " per turn" if figure.name.endswith("_per_turn") else ""
        groups[group].append(f"{std_text(value)} {figure.unit}{turn}")
    said = "; ".join(
        f"{group} {', '.join(values)}" if values else f"{group} fixed by the user"
        for group, values in groups.items()
    )
    whose = "your limits" if any(figure.name in limits for figure in FIGURES) else "the default limits"
    larger = [
        f"{error.limit:.3g} {error.figure.unit}"
        for error in errors
        if error.figure.name not in limits and error.limit != error.figure.limit
    ]
    size = f" of a robot of this size ({', '.join(larger)})" if larger else ""
    return f"Expected errors (1 sigma): {said}. All are within {whose}{size}."


@dataclass(frozen=True, slots=True)
class Stated:
    """A kind of constants of the robot description: its words.

    Attributes:
        family: its group of sources of errors, a key of `FAMILIES`.
        advice: what makes the stated value better, as a command, without a full stop.
        value: the stated value, after "differs from".
        cure: what to do where the data contradict it; in whole sentences.
    """

    family: str
    advice: str
    value: str
    cure: str


# fmt: off
_CAMERA = Stated(
    "camera_info", "Calibrate the cameras again with more images", "camera_info",
    "Check that camera_info belongs to these images (resolution, crop), and cameras.rectified. Calibrate the camera "
    "again, or use the exported camera_info.",
)
_PAIR = Stated(
    "camera_info", "Calibrate the stereo pair again with more images", "camera_info",
    "Recalibrate the stereo pair, or use the exported camera_info.",
)
_AMONG = Stated(
    "camera_info", "Calibrate the cameras together", "the robot description",
    "Correct the pose of this camera in the URDF or in the transforms, or use the exported camchain.",
)
_URDF = ("the URDF", "Correct the URDF, or use the exported URDF.")
_HEAD = Stated("head geometry", "Measure the geometry of the head", *_URDF)
STATED: dict[str, Stated] = {
    "clock": Stated("time stamps", "Synchronize the clocks", "equal clocks",
                    "Synchronize the clocks (NTP or PTP) and record again."),
    "focal_length": _CAMERA,
    "focal_aspect": _CAMERA,
    "stereo_clock": Stated("time stamps", "Stop for images, or trigger them together", "simultaneous images",
                           "Trigger both cameras together, or stop for images, and record again."),
    "readout": Stated("time stamps", "Stop for images, or use a global shutter", "a global shutter",
                      "State priors.readout in rig.yaml (in ms), or stop for images, and record again."),
    "principal_point": _CAMERA,
    "distortion": _CAMERA,
    "lens_waves": Stated("camera_info", "Calibrate the cameras with a richer distortion model",
                         "no more than the distortion model",
                         "Calibrate the cameras with a richer distortion model (rational_polynomial)."),
    "stereo_rotation": _PAIR,
    "baseline_direction": _PAIR,
    "baseline_length": _PAIR,
    "camera_rotation": _AMONG,
    "camera_position": _AMONG,
    "square_size": Stated("board", "Measure the board (ten squares, with a caliper)", "the stated size",
                          "Measure ten squares with a ruler, and correct board.square_m in rig.yaml."),
    "square_aspect": Stated("board", "Measure the board in both directions", "square",
                            "Print the board again without scaling, and measure it in both directions."),
    "board_bend": Stated("board", "Mount the board on a flat plate", "a flat board",
                         "Mount the board on a flat plate and record again."),
    "board_shear": Stated("board", "Measure the diagonals of the board", "a right angle",
                          "Print the board again on a printer that does not skew, and measure it."),
    "board_corners": Stated("board", "Use a board that is printed more exactly", "corners in their places",
                            "Print the board again, and mount it on a flat plate."),
    "lean": Stated("floor", "Check that the base stands upright", "an upright base",
                   "Check tires and casters for size and wear, and the axes of the base in the URDF."),
    "floor_shape": Stated("floor", "Record on a flat floor", "a plane floor",
                          "Record on a floor that is more even, or over less of it."),
    "joint_zero": Stated("head geometry", "Measure the zeros of the head joints", *_URDF),
    "joint_scale": Stated("head geometry", "Check the scale of the joint readings", "the reading",
                          "Check the gear ratio or the encoder counts of this joint."),
    "joint_axis": _HEAD,
    "joint_position": _HEAD,
    "turn_slip": Stated("wheels", "Turn at one rate", "no slip in turns",
                        "Turn more slowly, or on a floor with more grip."),
    "floor_drift": Stated("floor", "Record on a hard floor", "a floor that carries nothing along",
                          "Record on a hard floor, not on a carpet."),
    "turn_sides": Stated("wheels", "Turn as often to the left as to the right", "the mean of all turns",
                         "Check tires, casters and load: one separation cannot describe left and right turns."),
    "wheel_delay": Stated("time stamps", "Read both wheels at one time", "both wheels read at one time",
                          "Read both wheels in one message, check them for slip and play where they speed up, and "
                          "record again; or state priors.wheel_delay in rig.yaml (in ms)."),
    "wheel_smoothing": Stated("time stamps", "Stop for images, or publish positions as the encoders read them",
                              "unfiltered readings",
                              "Publish positions as the encoders read them, without a filter; or stop for images."),
    "backlash": Stated("head geometry", "Approach each head pose from both sides", "no backlash",
                       "Repair the joint, or approach each head pose from the same side."),
}
# fmt: on
class Family(NamedTuple):
    """A group of sources of errors.

    Attributes:
        limits: what it does in a sentence.
        style: in the chart of the error budget.
        sources: of a `Budget`, beside the constants of the robot description: noise levels, and what remains.
    """

    limits: str
    style: str
    sources: tuple[str, ...] = ()


#: Groups of sources in the chart's order: dark shades for measurements, light ones for the robot description.
FAMILIES = {
    "corners": Family("Corner noise limits", "blue dark", ("pixel_px", "shift_px")),
    "joint readings": Family("Joint reading noise limits", "orange dark", ("joint_rad",)),
    "floor": Family("The uneven floor limits", "green dark", ("floor_rad", "floor_m", "sway_rad", "sway_m")),
    "wheels": Family("Wheel noise limits", "red dark", ("wheel_rad_per_sqrt_rad", "wheel_share")),
    "encoder steps": Family("Encoder steps limit", "ink half", ("encoder_rad",)),
    "poses": Family("The measured poses limit", "faint dark", ("pose_scale",)),
    "time stamps": Family("Errors of the time stamps limit", "ink light", ("stamp_s", "pair_s")),
    "camera_info": Family("The stated camera calibration (camera_info) limits", "blue light"),
    "board": Family("The stated geometry of the board limits", "green light"),
    "head geometry": Family("The stated geometry of the head limits", "orange light"),
    "nominal values": Family(
        "The uncertainty of the nominal values limits",
        "red light",
        ("nominal", "unobservable"),
    ),
    "recordings": Family("The differences between the recordings limit", "ink dark", ("recordings",)),
    "other": Family("Other errors limit", "faint half"),
}
_FAMILY_OF = {name: family for family, group in FAMILIES.items() for name in group.sources}
_FAMILY_OF |= {kind: stated.family for kind, stated in STATED.items()}


def family_of(source: str) -> str:
    """The group of a source of a `Budget`."""
    return _FAMILY_OF.get(source, "other")


def family_shares(shares: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    """(share, group of sources) of an expected error with these (share, source), largest first; none is zero."""
    sums = dict.fromkeys(FAMILIES, 0.0)
    for share, name in shares:
        sums[family_of(name)] += share
    return sorted(((share, name) for name, share in sums.items() if share), key=lambda pair: -pair[0])
