"""Simulated extractions for the studies: the paper's robot with the noise of method.md, and what may go wrong."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners, Extraction
from mobilecal_cli.model.solution import EXACT, Noise
from mobilecal_cli.simulate.robot import PAPER_ROBOT, SimulatedRobot
from mobilecal_cli.simulate.route import Motion, Route, plan_route
from mobilecal_cli.solvers.initial import start_state
from tests import extractions
from tests.pairs import measured_anew
from tests.robots import in_cameras
from tests.truth import errors as errors
from tests.truth import no_priors, parameters_of

PIXEL_PX, WHEEL, JOINT_RAD = 0.2, 0.003, float(np.radians(0.05))  # method.md, last table but one
DISTURBED = extractions.Noise(PIXEL_PX, WHEEL, 0.0, JOINT_RAD)
TRUE_NOISE = Noise.exact(pixel_px=PIXEL_PX, wheel_rad_per_sqrt_rad=WHEEL, joint_rad=JOINT_RAD)
GIVEN = {"pixel_px": PIXEL_PX, "wheel_rad_per_sqrt_rad": WHEEL, "joint_rad": JOINT_RAD}
RUNS_PER_ROUTE = 10


@cache
def route_of(stations: int, number: int, motion: Motion = "standard") -> Route:
    """One of the routes that all runs share, `RUNS_PER_ROUTE` runs each."""
    return plan_route(PAPER_ROBOT, motion, stations=stations, seed=number)


def as_described(extraction: Extraction) -> Extraction:
    """The same for a robot that is exactly as described: no uncertain constants, a flat floor."""
    flat = dict.fromkeys(("floor_rad", "floor_m", "sway_rad", "sway_m", "stamp_s", "wheel_share"), EXACT)
    rig = extraction.rig
    return replace(extraction, rig=replace(rig, noise={**rig.noise, **flat}, prior_sigmas={"all": 0.0}))


def information_of(robot: SimulatedRobot, route: Route, inliers: Inliers | None = None) -> FloatArray:
    """(P, P) Fisher information about the shared numbers at the truth, from readings without any noise."""
    extraction = extractions.extraction_of(robot, route)
    data, true = dataset_of(extraction), parameters_of(robot)
    everything = Inliers.all_of(data)
    state, priors = start_state(data, true, everything), no_priors(data.layout, true)
    return Posterior.at(state, inliers or everything, TRUE_NOISE, priors).normal.S


@cache
def bound_of(stations: int, number: int) -> FloatArray:
    """(9, 9) Cramer-Rao bound of a standard route."""
    return np.linalg.inv(information_of(PAPER_ROBOT, route_of(stations, number)))[:9, :9]


def spoiled(
    extraction: Extraction, random: np.random.Generator, share: float = 0.2, slip: bool = True
) -> tuple[Extraction, FloatArray, int | None]:
    """The same with some boards moved by 20 to 150 mm and about 7 degrees, and one wheel that slips 0.08 to 0.4 rad.

    Returns:
        The extraction, the bad stations and the leg that slips.
    """
    count, seen = len(extraction.observations), list(extraction.observations)
    bad = np.sort(random.choice(count, max(1, round(share * count)), replace=False))
    rig, corners_k = extraction.rig.cameras, extraction.board.grid() * (extraction.board.square_m or 0.0)
    for i in bad:
        way = random.normal(size=3)
        displaced = np.eye(4)
        displaced[:3, :3] = Rotation.from_rotvec(random.normal(size=3) * np.radians(4)).as_matrix()
        displaced[:3, 3] = way / np.linalg.norm(way) * random.uniform(0.02, 0.15)
        T_c_k = seen[i].T_c_k @ displaced
        each = in_cameras(rig, T_c_k, corners_k)
        both = [Corners(at + PIXEL_PX * random.normal(size=at.shape), PIXEL_PX, 1) for at in each]
        moved = measured_anew(rig, replace(seen[i], T_c_k=T_c_k), corners_k, *both)
        assert moved is not None
        seen[i] = moved
    displaced = replace(extraction, observations=tuple(seen))
    if not slip:
        return displaced, bad, None
    leg = int(random.integers(0, count - 1))
    return extractions.slipped(displaced, leg, random.choice([-1, 1]) * random.uniform(0.08, 0.4)), bad, leg
