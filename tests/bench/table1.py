"""The paper's Table 1 on the sample log."""

from pathlib import Path

import numpy as np

from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.robot import PAPER_ROBOT, SimulatedRobot
from mobilecal_cli.solvers import solve
from tests.bench.study import NINE_COLUMNS, Study, head, line, numbers
from tests.truth import errors

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


def main(_: Study) -> None:
    """Print the table: the sample recording, solved by the method of the paper."""
    robot = PAPER_ROBOT
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
