"""Covariance of odometry: do 95 % regions contain 95 % of the errors over legs that the calibration did not use?"""

import itertools
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.export.formats.odometry_covariance import OdometryCovariance, odometry_covariance
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml
from mobilecal_cli.kinematics import Increments, integrate
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.solution import Provenance
from mobilecal_cli.simulate.route import Drive, Stretch
from mobilecal_cli.solvers import solve
from tests import extractions
from tests.bench.drawn import drawn
from tests.bench.imperfect import ROBOTS, Case, route_of
from tests.bench.simulated import RUNS_PER_ROUTE
from tests.bench.study import Study, head, line, results_of

RATE_HZ, SPEED_MPS = 50.0, 0.3
#: 95 % of chi-squared with 1 and 3 degrees of freedom.
INSIDE, INSIDE_3 = 3.841459, 7.814728
#: Length of the straight drives, m.
STRAIGHT_M = 5.0
QUANTITIES = ("x", "y", "heading", "x, y and heading", "pose: x, y", "pose: heading")
FIVE = "five legs together"
COARSE, COARSE_RAD = ", encoder steps of 1.2 degrees", float(np.radians(1.2))
RUNS = 200
STUDIED = ("paper's robot, N = 12", f"paper's robot, N = 12{COARSE}", "pan-tilt robot, N = 20")
_OTHER_ROUTES = 5000
#: The wheels' noise of each robot is the usual one times a factor between these.
_LEAST, _MOST = 0.5, 2.0


def robot_of(name: str, seed: int) -> Case:
    """A robot drawn from the priors, whose wheels have noise of their own."""
    case = drawn(name.removesuffix(COARSE))
    if name.endswith(COARSE):
        case = replace(case, noise=replace(case.noise, encoder_step_rad=COARSE_RAD))
    factor = np.exp(np.random.default_rng([seed, 11]).uniform(np.log(_LEAST), np.log(_MOST)))
    wheels = {name: factor * getattr(case.noise, name) for name in ("wheel_rad_per_sqrt_rad", "wheel_share")}
    return replace(case, noise=replace(case.noise, **wheels))


def inside(
    robot: CalibratedRobot, found: OdometryCovariance, case: Case, drive: Drive, ends_s: FloatArray, seed: int
) -> FloatArray:
    """Odometry with the calibrated wheels over the L legs of a drive between some times.

    Returns:
        (L, 6) whether each error is in its 95 % region, in the order of `QUANTITIES`.
    """
    true, dt = ROBOTS[case.robot], 1 / RATE_HZ
    times_s = np.unique(np.concatenate([np.arange(ends_s[0], ends_s[-1], dt), ends_s, drive.breaks_s]))
    times_s = times_s[(times_s >= ends_s[0]) & (times_s <= ends_s[-1])]
    leg = np.searchsorted(ends_s, times_s[:-1], side="right") - 1
    angles = drive.wheel_angles(times_s, true.wheels)
    rolled = extractions.rolled_as_read(angles, leg, case.noise, np.random.default_rng([seed, 13]))
    step = case.noise.encoder_step_rad
    if step:
        rolled = np.floor(rolled / step) * step
    motion = integrate(Increments(*np.diff(rolled, axis=0).T, leg, len(ends_s) - 1), robot.wheels)
    poses = drive.poses(ends_s)
    error, predicted, direction = [], [], []  # in the frame of the start: (3,), (3, 3), rad
    for number, (start, end) in enumerate(itertools.pairwise(poses)):
        truth = _seen_from(start, end[None])[0]
        off = np.append(motion.t_m[number], motion.psi_rad[number]) - truth
        off[2] = np.remainder(off[2] + np.pi, 2 * np.pi) - np.pi
        error.append(off)
        direction.append(np.arctan2(truth[1], truth[0]))
        at_s = np.arange(ends_s[number] + dt / 2, ends_s[number + 1], dt)
        before, after = (drive.wheel_angles(at_s + late * dt / 4, true.wheels) for late in (-1, 1))
        moves = np.any(np.abs(after - before) > 1e-9, axis=1)
        predicted.append(added_up(_seen_from(start, drive.poses(at_s[moves])), truth, found.twist, dt))
    e, P, direction_rad = np.array(error), np.array(predicted), np.array(direction)
    single = e**2 < INSIDE * np.diagonal(P, axis1=1, axis2=2)
    whole = np.einsum("la,lab,lb->l", e, np.linalg.inv(P), e) < INSIDE_3
    cos, sin = np.cos(direction_rad), np.sin(direction_rad)
    along = np.stack([cos * e[:, 0] + sin * e[:, 1], -sin * e[:, 0] + cos * e[:, 1]], axis=1)
    place = np.mean(along**2 < INSIDE * found.pose[:2], axis=1)
    heading = e[:, 2] ** 2 < INSIDE * found.pose[5]
    return np.column_stack([single, whole, place, heading])


def _seen_from(start: FloatArray, poses: FloatArray) -> FloatArray:
    """Poses (n, 3) in the frame of another."""
    apart = poses - start
    cos, sin = np.cos(start[2]), np.sin(start[2])
    x, y = cos * apart[:, 0] + sin * apart[:, 1], -sin * apart[:, 0] + cos * apart[:, 1]
    return np.stack([x, y, apart[:, 2]], axis=1)


def added_up(messages: FloatArray, end: FloatArray, twist: FloatArray, dt: float) -> FloatArray:
    """(3, 3) covariance of the end from velocities with independent errors, one per message.

    Args:
        messages: (n, 3) pose at each message.
        end: (3,) the end.
        twist: (6,) variances of one message's velocities.
        dt: s between messages.
    """
    cos, sin = np.cos(messages[:, 2]), np.sin(messages[:, 2])
    zero, one = np.zeros(len(messages)), np.ones(len(messages))
    along, across = np.stack([cos, sin, zero]), np.stack([-sin, cos, zero])
    turning = np.stack([messages[:, 1] - end[1], end[0] - messages[:, 0], one])
    parts = zip((along, across, turning), (twist[0], twist[1], twist[5]), strict=True)
    return np.asarray(dt**2 * sum(variance * (rows @ rows.T) for rows, variance in parts))


def drives(case: Case, seed: int) -> dict[str, tuple[Drive, FloatArray, float | None]]:
    """Name → another drive of the robot, the times that end its legs (s), and the distance to export for (m)."""
    route = route_of(case.robot, case.motion, case.stations, _OTHER_ROUTES + seed // RUNS_PER_ROUTE)
    stops_s = extractions.station_times_s(route)
    lasts_s = STRAIGHT_M / SPEED_MPS
    ahead = Drive((Stretch(lasts_s, SPEED_MPS),) * 10)
    return {
        "from stop to stop": (route.drive, stops_s, None),
        FIVE: (route.drive, stops_s[::5], None),
        f"{STRAIGHT_M:g} m straight, exported for the legs": (ahead, ahead.breaks_s, None),
        f"{STRAIGHT_M:g} m straight, exported for {STRAIGHT_M:g} m": (ahead, ahead.breaks_s, STRAIGHT_M),
    }


def one_robot(name: str, seed: int) -> tuple[dict[str, FloatArray], FloatArray] | str:
    """Whether each error is inside, for each drive; and the widening and the systematic shares."""
    case = robot_of(name, seed)
    extraction = case.extraction(seed)
    try:
        solution = solve(extraction)
    except MobilecalError as error:
        return error.message
    robot = parameters_from_yaml(params_yaml(solution, extraction, Provenance("", "", "ml", (), {})))
    found = odometry_covariance(robot, extraction, RATE_HZ)
    result = {}
    for label, (drive, ends_s, distance_m) in drives(case, seed).items():
        exported = odometry_covariance(robot, extraction, RATE_HZ, distance_m)
        result[label] = inside(robot, exported, case, drive, ends_s, seed)
    return result, np.array([found.path_m, found.widening, *found.systematic])


def row(label: str, each: list[FloatArray]) -> None:
    """Print coverage over all legs, with its standard error from the spread between the robots."""
    rows = np.concatenate(each)
    between = np.std([r.mean(axis=0) for r in each], axis=0) / np.sqrt(len(each))
    cells = [f"{mean:.3f} ± {error:.3f}" for mean, error in zip(rows.mean(axis=0), between, strict=True)]
    if label == FIVE:
        cells[4:] = ["", ""]  # the pose applies to one leg
    line(label, len(rows), *cells)


def study(name: str, robots: int) -> None:
    """Print the table of one case."""
    results = results_of(one_robot, name, seeds=range(robots))
    solved = [result for result in results if not isinstance(result, str)]
    title = f"### {name}: {len(solved)} robots, {robots - len(solved)} refused"
    head("drive", "errors", *QUANTITIES, title=title)
    for label in solved[0][0]:
        row(label, [inside[label] for inside, _ in solved])
    path, widening, length, heading = np.mean([values for _, values in solved], axis=0)
    shares = f"systematic share: length {length:.2f}, heading {heading:.2f}"
    print(f"\nmean leg {path:.2f} m; variances times {widening:.3f}; {shares}")


def main(asked: Study) -> None:
    """All cases; each run is a robot."""
    for name in asked.chosen(STUDIED):
        study(name, asked.runs)
