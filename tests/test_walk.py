"""From a simulated recording to the calibrated robot: the whole walk of a new user in a shell, with `make pages`."""

import pytest

from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from tests.test_pages import shell

pytestmark = pytest.mark.pages

#: Command, its exit code, and a part of what it prints.
STEPS = (
    ("mobilecal simulate monday.mcap --seed 11", 0, "Next: mobilecal calibrate monday.mcap"),
    ("mobilecal board --corners 8x5 --square 0.08 --output board.pdf", 0, "board: {"),
    ("mobilecal inspect monday.mcap", 0, ""),
    ("mobilecal init monday.mcap", 0, "Next: mobilecal check rig.yaml monday.mcap"),
    ("mobilecal check rig.yaml monday.mcap", 0, ""),
    ("mobilecal simulate ticks.mcap --robot tick --seed 13", 0, "--set wheels.left.ticks_per_revolution=4096"),
    ("mobilecal init ticks.mcap --output ticks.yaml", 0, "ticks_per_revolution"),
    ("mobilecal check ticks.yaml ticks.mcap", 2, "not filled in yet: wheels.left.ticks_per_revolution"),
    ("sed -i.bak 's/revolution: TODO/revolution: 4096/' ticks.yaml", 0, ""),
    ("mobilecal check ticks.yaml ticks.mcap", 0, ""),
    ("mobilecal calibrate monday.mcap --config rig.yaml --output monday --open", 0, "No display to open the report"),
    ("mobilecal calibrate monday/extraction.npz --set wheels.left.sign=-1 --output wrong", 5, "left wheel"),
    ("mobilecal calibrate monday/extraction.npz --set board.square_m=0.1 --output wrong", 2, "board.square_m cannot be"),
    ("mobilecal suggest monday.mcap", 0, "1. "),
    ("mobilecal simulate tuesday.mcap --seed 12 --quiet", 0, ""),
    ("mobilecal evaluate tuesday.mcap monday/params.yaml", 0, "PASS"),
    ("mobilecal calibrate tuesday.mcap --output tuesday --quiet --last monday/params.yaml", 0, ""),
    ("mobilecal compare monday/params.yaml tuesday/params.yaml --max-sigma 5", 0, ""),
    ("mobilecal calibrate monday.mcap tuesday.mcap --output both", 0, "PASS"),
    ("mobilecal export both/params.yaml --to urdf --urdf robot.urdf --output calibrated.urdf", 0, "Written"),
    ("diff robot.urdf calibrated.urdf", 1, "cylinder radius"),
    ("mobilecal export both/params.yaml --to ros2_control", 0, "wheel_separation"),
    ("mobilecal export both/params.yaml --to odometry_covariance", 0, "covariance"),
    ("mobilecal export monday/params.yaml --to foxglove --log monday.mcap --output scene.mcap", 0, "scene.layout.json"),
    ("mkdir fleet && ln monday.mcap tuesday.mcap fleet/ && mobilecal batch fleet --output all", 0, "2 of 2 robots passed"),
    ("mobilecal check ticks.yaml monday.mcap", 3, ""),
    ("head -c 600000 monday.mcap > cut.mcap; mobilecal calibrate cut.mcap", 4, "hint: "),
    ("mobilecal calibrate monday.mcap --set wheels.left.singn=-1", 2, "did you mean sign?"),
)  # fmt: skip


def test_the_walk_of_a_new_user(tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "robot.urdf").write_text(urdf_text(ROBOTS["paper"]), encoding="utf-8")
    for command, code, says in STEPS:
        done = shell(command, tmp_path)
        assert done.returncode == code, f"{command}\n{done.stdout}{done.stderr}"
        said = " ".join((done.stdout + done.stderr).split())  # lines are wrapped
        assert " ".join(says.split()) in said, f"{command}\n{done.stdout}{done.stderr}"
