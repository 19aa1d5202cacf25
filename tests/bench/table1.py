"""`make studies`: the paper's Table 1 on the sample log, and a Monte Carlo of the same robot, as Markdown."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.model import Parameters
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.robot import SimulatedRobot, paper_robot
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import solve
from tests.bench.simulated import errors
from tests.bench.study import NINE_COLUMNS, conditions, head, line, numbers, rms
from tests.extractions import Noise, ideal_extraction

_RUNS = 40
_SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs" / "paper_robot.mcap"


def in_camera(parameters: Parameters, robot: SimulatedRobot) -> np.ndarray:
    """Errors: rotation in the camera's frame (deg), translation and wheels (mm)."""
    off = errors(parameters, robot)
    return np.concatenate([np.degrees(robot.T_h_c[:3, :3].T @ off[:3]), 1e3 * off[3:]])


def wheel_rounds(history: tuple[Parameters, ...]) -> int:
    """The round after which neither radius nor the separation had moved by more than 0.1 %."""
    wheels = np.array([p.wheels.vector for p in history])
    steps = np.max(np.abs(np.diff(wheels, axis=0) / wheels[1:]), axis=1)
    return int(np.argmax(steps < 1e-3)) + 2


def sample() -> None:
    """The sample recording, solved by the method of the paper."""
    robot = paper_robot()
    extraction, _ = extract([_SAMPLE], load_rig(None))
    solutions = {method: solve(extraction, method) for method in ("linear", "paper", "lm")}
    linear = solutions["linear"].linear
    rounds = f"the wheels after round {wheel_rounds(linear.history)}, all parameters after"
    rounds += f" {linear.rounds_to_tolerance}; fixed after {linear.rounds}"
    print(f"Sample log, {len(extraction.observations)} stations. Within 0.1 %: {rounds}.\n")
    head("", *NINE_COLUMNS, "Error (mm)")
    for method, solution in solutions.items():
        off = in_camera(solution.parameters, robot)
        line(method, *numbers(off), f"{1e3 * solution.point_rms_m:.2f}")


def monte_carlo() -> None:
    """method.md's noise: 0.2 px, 0.003 rad per sqrt(rad), joints 0.05 degrees; a new route and new noise each run."""
    robot = paper_robot()
    noise = Noise(pixel_px=0.2, wheel_rad_per_sqrt_rad=0.003, joint_rad=np.radians(0.05))
    found: dict[str, list[np.ndarray]] = {"linear": [], "lm": []}
    rounds = []
    for seed in range(_RUNS):
        extraction = ideal_extraction(robot, plan_route(robot, seed=seed), noise, seed)
        for method, results in found.items():
            solution = solve(extraction, method)  # type: ignore[arg-type]
            results.append(in_camera(solution.parameters, robot))
        rounds.append(solution.linear.rounds_to_tolerance)
    counts = f"median {np.median(rounds):g}, maximum {max(rounds)}"
    print(f"\nMonte Carlo, {_RUNS} runs, rms errors; rounds to 0.1 %: {counts}.\n")
    head("", *NINE_COLUMNS)
    for method, results in found.items():
        line(method, *numbers(rms(np.array(results))))


def main() -> None:
    """Print both."""
    print(f"{conditions()}, OpenCV {cv2.__version__}\n")
    sample()
    monte_carlo()


if __name__ == "__main__":
    main()
