"""One, two and three cameras on the base, on a head that pans and on one that pans and tilts: are the sigmas true?

`python -m tests.bench.configurations [RUNS]`: robots with every constant drawn from its prior, 20 stops. NEES / n is over
the n parameters that the motion shows: all nine, or all but the camera's height where no joint tilts the camera.

`python -m tests.bench.configurations recordings`: one rendered recording of each robot with two wheel joints, four, tick
counters and odometry alone, in all containers in turn, from the file to the verdict.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.calibrate.steps import Fit, calibrate
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.model import NINE
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.robot import ROBOTS, TICKS_PER_REVOLUTION, SimulatedRobot
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.imperfect import (
    AS_PRINTED,
    LEVELS,
    USUAL,
    Case,
    Run,
    configuration,
    run_of_case,
    verdict_cells,
)
from tests.bench.simulated import errors
from tests.bench.study import Study, conditions, head, line, results_of
from tests.robots import CONFIGURATIONS, chain_of
from tests.truth import nees


def one_run(cameras: int, chain: str, seed: int) -> Run:
    """Noise levels estimated."""
    case = Case(configuration(cameras, chain)).drawn(noise=USUAL, outside=AS_PRINTED, levels_drawn=True)
    return run_of_case(case, seed)


def _against(found: Fit, robot: SimulatedRobot) -> tuple[float, float]:
    """NEES / n, and the largest error in sigmas."""
    hidden = unseen_height(chain_of(robot)) is not None
    kept = [k for k, name in enumerate(NINE) if not (hidden and name == "t_z")]
    error, known = errors(found.parameters, robot)[kept], found.solution.uncertainty
    return nees(found.parameters, known.covariance, robot, kept), float(np.abs(error / known.std[kept]).max())


_WHEELS = {"two joints": "joint_states", "four joints": "four_joints"}
_WHEELS |= {"counters": "ticks", "odometry": "odometry"}
_CONTAINERS = ("mcap", "bag", "rosbag2", "mcap-ros1", "rosbag2-mcap")


def recordings() -> None:
    """One recording of each robot."""
    print(conditions())
    head("cameras", "chain", "wheels", "container", "verdict", "NEES / n", "largest error (sigma)")
    containers = itertools.cycle(_CONTAINERS)
    for (cameras, chain), (wheels, signal) in itertools.product(CONFIGURATIONS, _WHEELS.items()):
        robot, container = replace(CONFIGURATIONS[cameras, chain](), wheel_signal=signal), next(containers)
        ROBOTS["this"] = lambda robot=robot: robot
        flags = {"board.square_m": 0.08} | (_counted(robot) if signal == "ticks" else {})
        for name in robot.mounted if cameras > 2 else ():
            flags |= _placed(robot, name)
        with tempfile.TemporaryDirectory() as folder:
            suffix = "" if container.startswith("rosbag2") else f".{container[:4].strip('-')}"
            log = Path(folder) / f"log{suffix}"
            simulate(Scenario(robot="this", container=container, seed=cameras), log)
            cells = [cameras, chain, wheels, container]
            try:
                report = calibrate([log], Path(folder) / "result", config=load_rig(None, flags))
            except MobilecalError as error:
                line(*cells, error.message, "", "")
                continue
            found = replace(robot, wheels=report.fit.parameters.wheels) if signal == "odometry" else robot
            off, worst = _against(report.fit, found)
            line(*cells, report.verdict.level, f"{off:.2f}", f"{worst:.1f}")


def _counted(robot: SimulatedRobot) -> dict[str, object]:
    return {f"wheels.{side}.ticks_per_revolution": TICKS_PER_REVOLUTION for side in ("left", "right")}


def _placed(robot: SimulatedRobot, name: str) -> dict[str, object]:
    """Topics and pose of one of several cameras."""
    topics, T = robot.topics(compressed=True), robot.mounted[name]
    pose = {"translation_m": T[:3, 3].tolist(), "quaternion_xyzw": se3.quaternion_xyzw(T[:3, :3]).tolist()}
    return {f"cameras.{name}.image": topics.image[name], f"cameras.{name}.info": topics.info[name]} | (
        {} if np.array_equal(T, np.eye(4)) else {f"cameras.{name}.pose": pose}
    )


def main() -> None:
    """All configurations; runs as an argument, 100 by default."""
    if sys.argv[1:] == ["recordings"]:
        recordings()
        return
    runs = Study.begun(100).runs
    head("cameras", "chain", "NEES / n", *LEVELS, "false PASS", title=f"{runs} runs each")
    for cameras, chain in CONFIGURATIONS:
        results = results_of(one_run, cameras, chain, seeds=range(runs), together=2)
        mean, _, *counts = verdict_cells(results)
        line(cameras, chain, mean, *counts)


if __name__ == "__main__":
    main()
