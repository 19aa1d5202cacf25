"""Simulated robots that are not as described, shared by the studies: cases, their solution, and tables."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot
from mobilecal_cli.model.findings import Jump
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.rig import AssumedOdometry, WheelGeometry
from mobilecal_cli.model.signals import Track
from mobilecal_cli.model.solution import Noise, Solution
from mobilecal_cli.readers.signals.sides import sides_of
from mobilecal_cli.readers.signals.wheels import Odometry
from mobilecal_cli.simulate.record import driver_odometry
from mobilecal_cli.simulate.robot import (
    FIXED_CAMERA_ROBOT,
    ODOMETRY_ROBOT,
    PAPER_ROBOT,
    RGBD_ROBOT,
    SKID_STEER_ROBOT,
    TICK_ROBOT,
    SimulatedRobot,
)
from mobilecal_cli.simulate.route import TURN_RADPS, Motion, Route, plan_route, slipping_radps
from mobilecal_cli.solvers import Constraints, solve
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.initial import start_state
from tests import extractions
from tests.actual import PRIORS, draw
from tests.bench.simulated import RUNS_PER_ROUTE
from tests.bench.study import Study, head, line, results_of, rms
from tests.extractions import STATION_NOISE, Outside, extraction_of
from tests.judging import judge
from tests.robots import CONFIGURATIONS, one_on_pan_tilt, three_on_pan_tilt
from tests.truth import errors, parameters_of

ROBOTS = {
    "paper": PAPER_ROBOT,
    "pan-tilt": TICK_ROBOT,
    "skid-steer": SKID_STEER_ROBOT,
    "odometry": ODOMETRY_ROBOT,
    "pair on the base": FIXED_CAMERA_ROBOT,
    "camera on the base": RGBD_ROBOT,
    "camera on pan-tilt": one_on_pan_tilt(),
    "three cameras": three_on_pan_tilt(),
}


def configuration(cameras: int, chain: str) -> str:
    """Key of a configuration among the robots."""
    return f"cameras: {cameras}, chain: {chain}"


ROBOTS |= {configuration(*key): robot for key, robot in CONFIGURATIONS.items()}
_DEVICES = {"pixel_px": 0.1, "wheel_rad_per_sqrt_rad": 0.003, "joint_rad": float(np.radians(0.02))}
_LEVELS = (*_DEVICES, "floor_rad", "floor_m", "sway_rad", "sway_m", "stamp_s", "wheel_share")
_LENGTHS, _OF_PAIRS = ("floor_length_m", "wheel_length_m"), ("pair_s", "shift_px")
#: A guess of the estimator is right within this factor (one sigma of the logarithm).
_LEVEL_FACTOR, _LENGTH_FACTOR = 1.6, 3.0
#: A scale error that is constant over stretches of length 2 L turns and displaces as much, over a long way, as one whose
#: correlation falls with exp(-d / L): both correlations have the same integral.
_STRETCHES_PER_LENGTH = 2.0
#: Noise of a robot that is as described, and at the first guesses of floor, stamps and wheels in proportion.
PERFECT, USUAL = extractions.Noise(**_DEVICES), replace(STATION_NOISE, **_DEVICES)
#: A floor and wheel errors that stay the same for a while; the floor is smooth.
CORRELATED = replace(USUAL, floor_length_m=0.3, floor_smooth=True, wheel_length_m=1.0)
#: Every corner's place on the board, and each lens, as the priors expect them.
AS_PRINTED = Outside(print_m=0.00015, print_across_m=0.0003, lens_px=0.1, lens_waves_px=(320.0, 1280.0))
FIVE_SIGMA = 5.0
_NOTHING = Outside()
_APART_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class Case:
    """What is simulated.

    Attributes:
        robot: key of `ROBOTS`.
        stations: number of stops.
        motion: kind of route.
        images: number of images of a moving recording.
        kinds: constants that are drawn: kind or name → times its prior's standard deviation.
        fixed: constants with a given value.
        noise: of the recording.
        outside: what no constant describes; every run has a board and lenses of its own.
        twice: every image is there twice, with the same corners and joint readings.
        right: kinds of constants that are a right answer to "what is wrong?".
        levels_drawn: the noise levels are drawn around the estimator's guesses, and so are the correlation lengths of
            floor and wheel scales.
    """

    robot: str = "pan-tilt"
    stations: int = 20
    motion: Motion = "standard"
    images: int = 40
    kinds: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    noise: extractions.Noise = PERFECT
    outside: Outside = _NOTHING
    twice: bool = False
    right: tuple[str, ...] = ()
    levels_drawn: bool = False

    def drawn(self, scale: float = 1.0, **changes: Any) -> Case:
        """The same with every kind of constant drawn from so many times its prior, and other changes."""
        return replace(self, kinds=all_kinds(self.motion == "moving", scale), **changes)

    def constants(self, seed: int) -> dict[str, float]:
        """The constants of one run."""
        drawn: dict[str, float] = {}
        for kind, scale in self.kinds.items():
            drawn |= draw(ROBOTS[self.robot], np.random.default_rng([seed, 7]), scale, {kind})
        return drawn | dict(self.fixed)

    def noise_of(self, seed: int) -> extractions.Noise:
        """The noise of one run."""
        if not self.levels_drawn:
            return self.noise
        guess, random = Noise.limits("guess"), np.random.default_rng([seed, 8])
        factors = dict.fromkeys(_LEVELS, _LEVEL_FACTOR) | dict.fromkeys(_LENGTHS, _LENGTH_FACTOR)
        factors |= dict.fromkeys(_OF_PAIRS, _LEVEL_FACTOR)
        drawn = {name: guess[name] * factor ** random.normal() for name, factor in factors.items()}
        drawn["wheel_length_m"] *= _STRETCHES_PER_LENGTH
        return replace(self.noise, **drawn)

    def extraction(self, seed: int) -> Extraction:
        """One run."""
        robot = ROBOTS[self.robot]
        drawn = self.outside.print_m or self.outside.lens_px
        outside = replace(self.outside, print_seed=seed, lens_seed=seed) if drawn else self.outside
        also = {"constants": self.constants(seed), "outside": outside, "images": self.images}
        extraction = extraction_of(robot, self.route(seed), self.noise_of(seed), seed, **also)
        extraction = as_recorded(robot, extraction, seed)
        return _twice(extraction) if self.twice else extraction

    def route(self, seed: int) -> Route:
        """The route of one run."""
        return route_of(self.robot, self.motion, self.stations, seed // RUNS_PER_ROUTE)


#: Slip of one of several wheels of a side, rad per sqrt(rad); and the separation that is assumed of a driver over its
#: own, as a relative standard deviation.
OWN_SLIP, ASSUMED_SHARE = 0.001, 0.2


def as_recorded(robot: SimulatedRobot, extraction: Extraction, seed: int) -> Extraction:
    """The wheels as this robot records them: several joints a side, or the odometry of its driver."""
    random = np.random.default_rng([seed, 9])
    if robot.wheel_signal == "four_joints":
        tracks = tuple(_of_four(track, random) for track in extraction.wheels)
        return replace(extraction, wheels=tracks)
    if robot.wheel_signal != "odometry":
        return extraction
    driver = robot.nominal_wheels
    assumed = replace(driver, separation_m=driver.separation_m * np.exp(ASSUMED_SHARE * random.normal()))
    tracks = tuple(_of_odometry(track, driver, assumed) for track in extraction.wheels)
    rig, also = extraction.rig, {"baked_in": assumed, "separation_share": ASSUMED_SHARE}
    wheels = {side: replace(source, **also) for side, source in rig.sources.wheels.items()}
    sources, nominal = replace(rig.sources, wheels=wheels), replace(rig.nominal, wheels=assumed)
    return replace(extraction, wheels=tracks, rig=replace(rig, sources=sources, nominal=nominal))


def _of_four(track: WheelTrack, random: np.random.Generator) -> WheelTrack:
    sides = {}
    for side, own in (("right", track.right), ("left", track.left)):
        slip = OWN_SLIP * np.sqrt(np.abs(np.diff(own.value, prepend=own.value[:1])))
        each = [own.value + np.cumsum(slip * random.normal(size=len(slip))) for _ in range(2)]
        sides[side] = [(f"{side} {k}", Track(own.time_ns, value)) for k, value in enumerate(each)]
    notes: list[str] = []
    averaged = sides_of(sides, notes)
    assert not notes
    return WheelTrack(averaged["right"], averaged["left"])


def _of_odometry(track: WheelTrack, driver: WheelGeometry, assumed: WheelGeometry) -> WheelTrack:
    rolled = np.stack([track.right.value, track.left.value], axis=1)
    poses = driver_odometry(rolled, driver)
    right, left, jumps = Odometry("", track.time_ns, poses).rotations(assumed)
    assert not jumps.any()
    return WheelTrack.at_same_times(track.time_ns, right, left)


def true_robot(robot: SimulatedRobot, extraction: Extraction, route: Route) -> SimulatedRobot:
    """The robot with the wheels that are true of an extraction.

    Of odometry, these are factors of the assumed wheels; of wheels that slip, the separation is that at the mean
    turning rate.
    """
    odometry = extraction.rig.sources.assumed_odometry
    if robot.slip:
        turns = [(slipping_radps(s), abs(s.w_radps) * s.duration_s) for s in route.drive.stretches]
        mean_radps = sum(rate * turn for rate, turn in turns) / sum(turn for _, turn in turns)
        wheels = robot.wheels
        wider = 1 + robot.slip * (mean_radps - TURN_RADPS)
        return replace(robot, wheels=replace(wheels, separation_m=wheels.separation_m * wider))
    if odometry is None:
        return robot
    driver = AssumedOdometry(odometry.topic, robot.nominal_wheels)
    calibrated = CalibratedRobot("", "", np.eye(4), robot.wheels, odometry=driver)
    return replace(robot, wheels=calibrated.with_assumed(odometry.wheels).wheels)


def _twice(extraction: Extraction) -> Extraction:
    seen = []
    for o in extraction.observations:
        seen += [replace(o, station=2 * o.station + k, time_ns=o.time_ns + k * _APART_NS) for k in range(2)]
    return replace(extraction, observations=tuple(seen))


def all_kinds(moving: bool, scale: float = 1.0) -> dict[str, float]:
    """Every kind of constant; the clocks' offsets in moving recordings only, with at most 20 ms."""
    kinds = dict.fromkeys(PRIORS, scale)
    clock = kinds.pop("clock")
    return kinds | ({"clock": 0.1 * clock} if moving else {})


@cache
def route_of(robot: str, motion: Motion, stations: int, number: int) -> Route:
    """One of the routes that all runs share."""
    return plan_route(ROBOTS[robot], motion, stations=stations, seed=number)


def given(noise: extractions.Noise) -> dict[str, float]:
    """All levels of a simulation as known, and the correlation lengths of processes."""
    known = {name: getattr(noise, name) for name in (*_LEVELS, *_OF_PAIRS, *_LENGTHS)}
    known["wheel_length_m"] /= _STRETCHES_PER_LENGTH
    return {name: level for name, level in known.items() if level}


def bound_of(
    robot: str, motion: Motion, stations: int, number: int, noise: extractions.Noise = USUAL
) -> FloatArray:
    """(9, 9) Bayesian Cramer-Rao bound: inverse of the information with all priors, from readings without noise."""
    true, route = ROBOTS[robot], route_of(robot, motion, stations, number)
    extraction = extractions.extraction_of(true, route)
    inference = Inference.of(extraction, Constraints())
    data = inference.data
    parameters, everything = parameters_of(true), Inliers.all_of(dataset_of(extraction))
    levels = Noise.exact(**given(noise))
    state = start_state(data, parameters, everything)
    lin = Posterior.at(state, everything, levels, inference.priors(state))
    bound: FloatArray = np.linalg.inv(lin.information)[:9, :9]
    return bound


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One solved run.

    Attributes:
        error: (9,) found minus true; NaN where the solver refused.
        std: (9,) stated standard deviations.
        nees: (4,) squared normalized error of rotation, translation and wheels, each over 3, and of all that the motion
            of the robot can show, over their number.
        level: verdict.
        named: kind of each contradiction, most significant first.
        outliers: number of outliers other than single corners.
        jumps: changes inside the recording that are named.
        seconds: processor time of solution and verdict.
    """

    error: FloatArray
    std: FloatArray
    nees: FloatArray
    level: str
    named: tuple[str, ...]
    outliers: int
    jumps: tuple[Jump, ...] = ()
    seconds: float = 0.0

    @property
    def beyond(self) -> bool:
        """One of the nine is beyond five stated standard deviations."""
        return bool(np.any(np.abs(self.error) > FIVE_SIGMA * self.std))

    @property
    def false_pass(self) -> bool:
        """PASS, and one of the nine beyond five stated standard deviations."""
        return self.level == "PASS" and self.beyond


def run_of(extraction: Extraction, robot: SimulatedRobot) -> Run:
    """Solve and judge one extraction."""
    start = time.process_time()
    try:
        run = judged(solve(extraction), extraction, robot)
        return replace(run, seconds=time.process_time() - start)
    except MobilecalError as error:
        return refused(error)


def run_of_case(case: Case, seed: int) -> Run:
    """Record, solve and judge one run; a recording may be refused before it is solved."""
    try:
        extraction = case.extraction(seed)
    except MobilecalError as error:
        return refused(error)
    return run_of(extraction, true_robot(ROBOTS[case.robot], extraction, case.route(seed)))


def refused(error: MobilecalError) -> Run:
    """A recording without a result."""
    nothing = np.full(9, np.nan)
    return Run(nothing, nothing, np.full(4, np.nan), f"refused: {error.message[:60]}", (), 0)


def judged(solution: Solution, extraction: Extraction, robot: SimulatedRobot) -> Run:
    """One solved extraction against the truth."""
    known = solution.uncertainty
    assert known is not None
    error, C = errors(solution.parameters, robot), known.covariance
    shown = [k for k in range(9) if k != NINE.index("t_z") or unseen_height(extraction.rig.chain) is None]
    parts = [[0, 1, 2], [3, 4, 5], [6, 7, 8], shown]
    nees = [float(error[p] @ np.linalg.solve(C[np.ix_(p, p)], error[p])) / len(p) for p in parts]
    level = judge(solution, extraction).level
    named = tuple(found.kind for found in solution.contradictions)
    gross = sum(outlier.kind != "corners" for outlier in solution.outliers)
    return Run(error, known.std, np.array(nees), level, named, gross, solution.jumps)


def level_counts(runs: Sequence[Run]) -> list[int]:
    """Number of PASS, FAIL, NOT ENOUGH, and of refused recordings."""
    counts = Counter(run.level.partition(":")[0] for run in runs)
    return [counts[level] for level in LEVELS]


#: Heads of `verdict_cells`.
LEVELS = ("PASS", "FAIL", "NOT ENOUGH", "refused")
VERDICTS = ("mean NEES / n", "median", *LEVELS, "false PASS")


def verdict_cells(runs: Sequence[Run]) -> list[object]:
    """NEES and verdicts of some runs."""
    nees = np.array([run.nees[3] for run in runs])
    false = sum(run.false_pass for run in runs)
    return [f"{np.nanmean(nees):.2f}", f"{np.nanmedian(nees):.2f}", *level_counts(runs), false]


def print_cases(
    asked: Study,
    cases: Mapping[tuple[str, ...], Case],
    heads: Sequence[str],
    figures: Callable[[Sequence[Run], Case], Sequence[object]],
    title: str = "",
    remarkable: Callable[[Run], bool] = lambda _: False,
    seeds_of: Callable[[Case], Sequence[int]] | None = None,
) -> None:
    """A table with a line for each case.

    Args:
        asked: the number of runs; cases with a part in one of their labels.
        cases: labels, which are the first cells → case.
        heads: of all cells.
        figures: the other cells, of all runs of a case.
        title: above the table.
        remarkable: runs that have a line of their own.
        seeds_of: seeds of a case, in place of the number of runs.
    """
    head(*heads, title=title)
    for labels, case in cases.items():
        if asked.chosen(labels):
            seeds = range(asked.runs) if seeds_of is None else seeds_of(case)
            runs = results_of(run_of_case, case, seeds=seeds, together=2)
            line(*labels, *figures(runs, case))
            print_runs(runs, remarkable, seeds)


def print_runs(
    runs: Sequence[Run], remarkable: Callable[[Run], bool], seeds: Iterable[int] | None = None
) -> None:
    """Print a line for each remarkable run; its seed is its number unless stated."""
    for seed, run in zip(range(len(runs)) if seeds is None else seeds, runs, strict=True):
        if remarkable(run):
            changed = [jump.part for jump in run.jumps]
            print(f"  seed {seed}: {run.level}, NEES / n {run.nees[3]:.2f}, {run.named}, {changed}")


def summary(error: FloatArray, case: Case) -> list[str]:
    """Root-mean-square errors (n, 9) of rotation (deg), translation (mm) and wheels (%), as three cells."""
    size = rms(error)
    rotation, translation = np.degrees(np.linalg.norm(size[:3])), 1e3 * np.linalg.norm(size[3:6])
    wheels = 100 * float(np.max(size[6:] / ROBOTS[case.robot].wheels.vector))
    return [f"{rotation:.3f}", f"{translation:.2f}", f"{wheels:.3f}"]
