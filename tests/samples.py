"""`make logs`: writes the recordings in sample_logs/, with fixed seeds."""

import sys
from pathlib import Path

from mobilecal_cli.model.rig import Board
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.scenario import Scenario, World
from tests.actual import ImperfectWorld
from tests.robots import rgbd_with_odometry, skid_steer_that_pans

ROBOTS |= {"rgbd_odometry": rgbd_with_odometry(), "skid_steer_pan": skid_steer_that_pans()}

_SMALL_BOARD = Board(9, 6, 0.07)
SAMPLES: dict[str, Scenario] = {
    "paper_robot.mcap": Scenario(),
    "paper_robot.bag": Scenario(container="bag"),
    "paper_robot_rosbag2": Scenario(container="rosbag2"),
    "tick_robot.mcap": Scenario(robot="tick", board=_SMALL_BOARD, seed=1),
    "imperfect_robot.mcap": Scenario(stations=16, seed=2),
    "head_fixed.mcap": Scenario(motion="head_fixed", stations=10),
    "straight.mcap": Scenario(motion="straight", stations=10),
    "rgbd_odometry.mcap": Scenario(robot="rgbd_odometry", seed=3),
    "skid_steer_pan.mcap": Scenario(robot="skid_steer_pan", seed=4),
}


# No recording contains the resolution of a tick counter.
TICK_RIG = """# Wheel encoders of the tick robot, whose resolution is not in the recording.
schema_version: 1
wheels:
  left:  {topic: /wheel_ticks/left,  field: data, ticks_per_revolution: 4096, bits: 16}
  right: {topic: /wheel_ticks/right, field: data, ticks_per_revolution: 4096, bits: 16}
"""


def main(directory: Path) -> None:
    """Write all samples to a directory, replacing existing ones."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "tick_robot.rig.yaml").write_text(TICK_RIG, encoding="utf-8")
    for name, scenario in SAMPLES.items():
        world_of = ImperfectWorld if name.startswith("imperfect") else World
        simulate(scenario, directory / name, force=True, world_of=world_of)
        print(f"written: {directory / name}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
