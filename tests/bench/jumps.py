"""Something changes inside a recording: is it named with its time, and does the old value ever pass?"""

import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.signals import Track
from mobilecal_cli.model.solution import Solution
from mobilecal_cli.simulate.robot import TICK_ROBOT, SimulatedRobot
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.solvers import solve
from tests.bench.imperfect import CORRELATED, FIVE_SIGMA, LEVELS, Case, judged, level_counts, refused
from tests.bench.imperfect import Run as Result
from tests.bench.study import Study, head, line, results_of
from tests.extractions import extraction_of

RUNS = 30
RECORDINGS = {
    "20 stations": Case(stations=20).drawn(noise=CORRELATED),
    "40 stations": Case(stations=40).drawn(noise=CORRELATED),
    "40 images in motion": Case(motion="moving").drawn(noise=CORRELATED),
}
FACTORS, MOMENTS = (1.0, 3.0, 10.0), (0.25, 0.5, 0.75)
_STEREO = tuple(f"stereo_r_{axis}" for axis in "xyz")


@dataclass(frozen=True, eq=False)
class World:
    """A robot and its surroundings, before or after a change.

    Attributes:
        robot: the robot; after a change, with the new head-eye transform or wheels.
        route: the route, with the place of the board.
        constants: that have new values after a change.
        last: head-eye transform and wheels that are right after a change.
    """

    robot: SimulatedRobot
    route: Route
    constants: Mapping[str, float] = field(default_factory=dict)
    last: SimulatedRobot | None = None


def _pose_step(known: Solution, way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation matrix and shift that change the head-eye transform by |way| stated standard deviations."""
    assert known.uncertainty is not None
    step = np.linalg.cholesky(known.uncertainty.covariance[:6, :6]) @ way
    return Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]


def _mount(was: World, known: Solution, way: FloatArray) -> World:
    R, shift = _pose_step(known, way)
    T = was.robot.T_h_c
    return replace(was, robot=replace(was.robot, T_h_c=se3.transform(R @ T[:3, :3], T[:3, 3] + shift)))


def _board(was: World, known: Solution, way: FloatArray) -> World:
    T = se3.transform(*_pose_step(known, way))
    return replace(was, route=replace(was.route, T_w_k=was.route.T_w_k @ T))


def _signed(way: FloatArray) -> float:
    return float(np.sign(way[0]) * np.linalg.norm(way))


def _pan(was: World, known: Solution, way: FloatArray) -> World:
    return replace(was, constants={"pan_zero": _signed(way) * known.constants["pan_zero"].std})


def _tilt(was: World, known: Solution, way: FloatArray) -> World:
    assert known.uncertainty is not None
    robot = was.robot
    joint = next(joint for joint in robot.joints if joint.name == robot.tilt)
    axis = np.array(joint.axis)  # in the head's frame too: what follows the joint is a translation
    turn = _signed(way) * float(np.sqrt(axis @ known.uncertainty.covariance[:3, :3] @ axis))
    ahead = np.where(np.array(robot.joint_names) == robot.tilt, turn, 0.0)
    T = se3.inverse(robot.head_pose(np.zeros(len(ahead)))) @ robot.head_pose(ahead) @ robot.T_h_c
    return replace(was, constants={"tilt_zero": turn}, last=replace(robot, T_h_c=T))


def _camera(was: World, known: Solution, way: FloatArray) -> World:
    turn = way[:3] * np.linalg.norm(way) / np.linalg.norm(way[:3])
    steps = zip(_STEREO, turn, strict=True)
    return replace(was, constants={name: t * known.constants[name].std for name, t in steps})


def _wheel(was: World, known: Solution, way: FloatArray) -> World:
    assert known.uncertainty is not None
    wheels = was.robot.wheels
    radius = wheels.radius_right_m + _signed(way) * float(known.uncertainty.std[6])
    return replace(was, robot=replace(was.robot, wheels=replace(wheels, radius_right_m=radius)))


#: What changes → the world after it, by so many standard deviations in a direction of six.
CHANGES: dict[str, Callable[[World, Solution, FloatArray], World]] = {
    "head mount": _mount,
    "joint pan_joint": _pan,
    "joint tilt_joint": _tilt,
    "right camera": _camera,
    "right wheel": _wheel,
    "board": _board,
}


def spliced(before: Extraction, after: Extraction, first: int, ratio: float) -> Extraction:
    """One recording whose stations and joint readings are those of another from a station on.

    Args:
        before, after: with the same stamps and the same noise.
        first: index of the first station after the change, which is half-way from the station before.
        ratio: rotations of the right wheel after the change, over those before.
    """
    both = zip(before.observations, after.observations, strict=True)
    seen = tuple(b if i >= first else a for i, (a, b) in enumerate(both))
    moment_ns = (seen[first - 1].time_ns + seen[first].time_ns) // 2
    joints = tuple(
        Track(a.time_ns, np.where(a.time_ns > moment_ns, b.value, a.value))
        for a, b in zip(before.joint_tracks[0], after.joint_tracks[0], strict=True)
    )
    wheels = before.wheels[0]
    right = wheels.right_rad.copy()
    start = int(np.searchsorted(wheels.time_ns, moment_ns))
    right[start:] = right[start] + (right[start:] - right[start]) * ratio
    track = WheelTrack.at_same_times(wheels.time_ns, right, wheels.left_rad)
    return replace(before, observations=seen, joint_tracks=(joints,), wheels=(track,))


def changed(
    case: Case, part: str, factor: float, seed: int, known: Solution
) -> tuple[Extraction, World, int, dict[str, float]]:
    """A recording with a change, the world after it, the first station after it, and all constants after it."""
    robot, route, constants = TICK_ROBOT, case.route(seed), case.constants(seed)
    unit = np.random.default_rng([seed, 8]).normal(size=6)
    after = CHANGES[part](World(robot, route), known, factor * unit / np.linalg.norm(unit))
    now = {**constants, **{n: constants.get(n, 0.0) + more for n, more in after.constants.items()}}
    head = replace(after.robot, wheels=robot.wheels)
    other = extraction_of(head, after.route, case.noise, seed, constants=now, images=case.images)
    before = case.extraction(seed)
    first = round(MOMENTS[seed % len(MOMENTS)] * len(before.observations))
    ratio = robot.wheels.radius_right_m / after.robot.wheels.radius_right_m
    return spliced(before, other, first, ratio), after, first, now


@dataclass(frozen=True, eq=False)
class Run:
    """One recording with a change.

    Attributes:
        result: against the values after the change.
        beyond: one of the nine, or a constant that changed, is beyond five stated sigmas of its last value.
        named: part, and number of stations from the first one after the change; None if nothing is named. A leg
            that is left out names "wheel slip or moved board".
    """

    result: Result
    beyond: bool
    named: tuple[str, int] | None


def one_change(case: Case, part: str, factor: float, seed: int, known: Solution) -> Run:
    """Solve one recording with a change."""
    extraction, after, first, now = changed(case, part, factor, seed, known)
    try:
        solution = solve(extraction)
    except MobilecalError as error:
        return Run(refused(error), False, None)
    result = judged(solution, extraction, after.last or after.robot)
    shown = {name: solution.constants[name] for name in after.constants if name in solution.constants}
    off = [abs(found.value - now[name]) / found.std for name, found in shown.items()]
    named = [(jump.part, jump.station - first) for jump in solution.jumps]
    named += [("board", o.observations[-1] - first) for o in solution.outliers if o.kind == "slip"]
    return Run(result, result.beyond or max(off, default=0.0) > FIVE_SIGMA, named[0] if named else None)


def one_run(name: str, seed: int) -> tuple[Run, dict[tuple[str, float], Run]]:
    """A recording without a change, and with each change in each size."""
    case = RECORDINGS[name]
    extraction = case.extraction(seed)
    known = solve(extraction)
    same = judged(known, extraction, TICK_ROBOT)
    still = Run(same, same.beyond, (known.jumps[0].part, 0) if known.jumps else None)
    each = itertools.product(CHANGES, FACTORS)
    return still, {change: one_change(case, *change, seed, known) for change in each}


def _line(label: str, part: str, runs: list[Run]) -> None:
    named = [run.named for run in runs]
    near = [n for n in named if n and abs(n[1]) <= 1]
    right = sum(n[0] == part for n in near)
    line(
        label,
        f"{right} of {len(runs)}",
        len(near) - right,
        sum(n is not None for n in named) - len(near),
        *level_counts([run.result for run in runs]),
        sum(run.beyond and run.result.level == "PASS" for run in runs),
    )


def study(name: str, runs: int) -> None:
    """Print the table of one recording."""
    results = results_of(one_run, name, seeds=range(runs), together=1)
    head(
        "change", "named: part and time", "another part, time right", "another time", *LEVELS, "PASS beyond five sigmas",
        title=f"### {name}, {runs} runs",
    )  # fmt: skip
    _line("none", "", [still for still, _ in results])
    for part in CHANGES:
        for factor in FACTORS:
            each = [found[part, factor] for _, found in results]
            _line(f"{part}, {factor:g} sigma", part, each)
            others = Counter(run.named for run in each if run.named and run.named != (part, 0))
            passed = [k for k, run in enumerate(each) if run.beyond and run.result.level == "PASS"]
            missed = [k for k, run in enumerate(each) if run.named is None] if factor == FACTORS[-1] else []
            refusals = [run.result.level for run in each if run.result.level.startswith("refused")]
            also = {
                "named": dict(others),
                "false PASS, seeds": passed,
                "not named, seeds": missed,
                "": refusals,
            }
            for what, found in also.items():
                if found:
                    print(f"  {what} {found}")


def main(asked: Study) -> None:
    """All recordings."""
    print("\nChanges at 25, 50 and 75 % of the recording, in turn; every constant is drawn from its prior.")
    for name in asked.chosen(RECORDINGS):
        study(name, asked.runs)
