"""Robots whose geometry is drawn, too: are the standard deviations true, and are mistakes named?

Wheels of 3 to 30 cm, other places of the joints and of the camera, one that is rolled by 90 degrees, boards of other
sizes, 9 to 30 stops or 30 to 110 images in motion. Every constant is drawn from its prior.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.errors import ConfigError, MobilecalError
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import Board, WheelGeometry
from mobilecal_cli.simulate.robot import SimulatedRobot
from mobilecal_cli.simulate.route import Motion, Route, plan_route
from mobilecal_cli.solvers import solve
from tests.bench.imperfect import (
    AS_PRINTED,
    ROBOTS,
    USUAL,
    VERDICTS,
    Case,
    Run,
    as_recorded,
    print_runs,
    refused,
    run_of,
    true_robot,
    verdict_cells,
)
from tests.bench.study import Study, head, line, results_of
from tests.extractions import extraction_of
from tests.hostile.meaning import both, joint, joints, late, same, times, wheels
from tests.judging import judge
from tests.robots import one_that_pans

RUNS = 110
_BOARDS = ((7, 5), (8, 5), (9, 6), (5, 4), (11, 8))
_KINDS = [key for key in ROBOTS if not key.startswith("cameras")]
_WORTH_A_LINE = 3.0  # NEES / n
_ROUTES = 8  # that are tried: not every camera sees the board on the way
#: Mistake → what is changed, and what the message must say; of odometry, that it is wrong is enough.
MISTAKES: Mapping[str, tuple[Callable[[Extraction], Extraction], str]] = {
    "right wheel reversed": (wheels(times(-1), same), "the right wheel's encoder has the wrong sign"),
    "both wheels reversed": (both(times(-1)), "the encoders of both wheels have the wrong sign"),
    "wheels exchanged": (wheels(same, same, swapped=True), "the left and right wheels are swapped"),
    "wheels in degrees": (both(times(180 / np.pi)), "wheel readings are in degrees|times the nominal"),
    "wheels 2 s late": (both(late(2.0)), r"both wheels are about [12]\.\d s late"),
    "first joint reversed": (joint(0, lambda q: -q), "the sign of joint"),
    "last joint reversed": (joint(-1, lambda q: -q), "the sign of joint"),
    "joints in degrees": (joints(np.degrees), "the joint readings are in degrees"),
}


def robot_of(random: np.random.Generator) -> tuple[str, SimulatedRobot]:
    """A robot with its kind."""
    kind = str(random.choice([*_KINDS, "one that pans", "rolled", "mast"]))
    robot = {"one that pans": one_that_pans()}.get(kind, ROBOTS.get(kind, ROBOTS["pan-tilt"]))
    radius_m = float(np.exp(random.uniform(np.log(0.03), np.log(0.3))))
    separation_m = float(np.clip(radius_m * random.uniform(2.2, 7.0), 0.15, 1.2))
    right, left, apart = 1 + np.array([0.01, 0.01, 0.02]) * random.normal(size=3)
    if not robot.slip:
        true = WheelGeometry(radius_m * right, radius_m * left, separation_m * apart)
        robot = replace(robot, wheels=true, nominal_wheels=WheelGeometry(radius_m, radius_m, separation_m))
    joint_list = []
    for each in robot.joints:
        x, y, z = np.array(each.xyz_m) + np.array([0.06, 0.02, 0.1]) * random.normal(size=3)
        joint_list.append(replace(each, xyz_m=(float(x), float(y), float(z))))
    if kind == "mast":
        joint_list[0] = replace(joint_list[0], xyz_m=(*joint_list[0].xyz_m[:2], 1.4))
    T_h_c = robot.T_h_c.copy()
    T_h_c[:3, 3] += 0.05 * random.normal(size=3)
    turn = 0.1 * random.normal(size=3) + np.array([0.0, 0.0, np.pi / 2 if kind == "rolled" else 0.0])
    T_h_c[:3, :3] = T_h_c[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    return kind, replace(robot, joints=tuple(joint_list), T_h_c=T_h_c)


def recorded(seed: int, motion: Motion | None = None) -> tuple[str, Extraction, SimulatedRobot]:
    """Kind of the robot, a recording, and the robot that is true of it.

    Raises:
        ConfigError: its cameras see the board from no route.
    """
    random = np.random.default_rng([seed, 99])
    kind, robot = robot_of(random)
    motion = motion or ("moving" if random.uniform() < 0.3 else "standard")
    stations = int(random.integers(9, 31)) if motion == "standard" else 20
    columns, rows = _BOARDS[random.integers(len(_BOARDS))]
    board = Board(columns, rows, float(random.uniform(0.04, 0.11)))
    route = _route_of(robot, motion, stations, board, seed)
    drawn = Case(motion=motion).drawn(noise=USUAL, levels_drawn=True)
    constants = replace(drawn, robot=_key_of(robot)).constants(seed)
    outside = replace(AS_PRINTED, print_seed=seed, lens_seed=seed)
    also = {"constants": constants, "outside": outside, "images": int(random.integers(30, 111))}
    extraction = as_recorded(robot, extraction_of(robot, route, drawn.noise_of(seed), seed, **also), seed)
    return kind, extraction, true_robot(robot, extraction, route)


def _key_of(robot: SimulatedRobot) -> str:
    """A key of `ROBOTS` whose constants have the same names."""
    names = robot.joint_names, tuple(robot.rig_cameras.names)
    return next(key for key, of in ROBOTS.items() if (of.joint_names, tuple(of.rig_cameras.names)) == names)


def _route_of(robot: SimulatedRobot, motion: Motion, stations: int, board: Board, seed: int) -> Route:
    for number in range(_ROUTES):
        try:
            return plan_route(robot, motion, stations, board, seed=_ROUTES * seed + number)
        except ConfigError:
            continue
    raise ConfigError("no route on which the cameras see the board", "another seed")


def healthy(seed: int) -> Run | None:
    """One robot; None without a route."""
    try:
        _, extraction, robot = recorded(seed)
    except ConfigError:
        return None
    return run_of(extraction, robot)


def wrong(seed: int) -> list[tuple[str, str]]:
    """Mistake → "named", "another cause", or the verdict without one; none without a route."""
    try:
        _, extraction, _ = recorded(seed, "standard")
    except ConfigError:
        return []
    said = []
    for name, (change, cause) in MISTAKES.items():
        if "joint" in name and not extraction.rig.chain.joints:
            continue
        made = change(extraction)
        try:
            verdict = judge(solve(made), made)
            level, message = verdict.level, verdict.reason
        except MobilecalError as error:
            level, message = refused(error).level.partition(":")[0], error.message
        named = re.search(cause, message) or (made.rig.sources.assumed_odometry and "odometry" in message)
        said.append((name, "named" if named and level != "PASS" else level))
    return said


def main(asked: Study) -> None:
    """Healthy robots, and a third as many with each mistake."""
    each = {
        seed: run for seed, run in enumerate(results_of(healthy, seeds=range(asked.runs))) if run is not None
    }
    runs = list(each.values())
    head("robots", *VERDICTS, title="Healthy robots")
    line(len(runs), *verdict_cells(runs))
    print_runs(runs, lambda run: run.level != "PASS" or run.nees[3] > _WORTH_A_LINE, each)
    counts: dict[str, Counter[str]] = {name: Counter() for name in MISTAKES}
    for said in results_of(wrong, seeds=range(asked.runs // 3), together=1):
        for name, outcome in said:
            counts[name][outcome] += 1
    head("mistake", "recordings", "named", "others", title="Mistakes")
    for name, of in counts.items():
        others = ", ".join(f"{count} {outcome}" for outcome, count in of.items() if outcome != "named")
        line(name, of.total(), of["named"], others or "-")
