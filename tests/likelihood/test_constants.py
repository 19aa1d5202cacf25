"""The table of constants: its rows and their priors."""

import numpy as np

from mobilecal_cli.likelihood.constants import FREED_SIGMAS, KINDS, PATTERNS, floors_of, table, with_priors
from mobilecal_cli.simulate.robot import PAPER_ROBOT, TICK_ROBOT
from tests.robots import chain_of, three_on_pan_tilt


def test_every_kind_of_the_table_has_rows():
    of_others = {"camera_rotation", "camera_position"}
    of_pairs = {"stereo_rotation", "baseline_direction", "baseline_length"}
    lacking = ((PAPER_ROBOT, of_others), (TICK_ROBOT, of_others), (three_on_pan_tilt(), of_pairs))
    for robot, lacks in lacking:
        rows = (*table(robot.rig_cameras, chain_of(robot)), *floors_of([0, 1]))
        assert {row.kind for row in rows} | PATTERNS == {kind.name for kind in KINDS} - lacks
        names = [row.name for row in rows]
        assert len(set(names)) == len(names)
        assert "tilt_zero" not in names  # the head-eye transform absorbs the last zero


def test_priors_narrow_widen_fix_and_free():
    robot = TICK_ROBOT
    rows = table(robot.rig_cameras, chain_of(robot))
    given = {"focal_length": 0.01, "focal_left": 0.0, "joint_zero": np.inf, "pan_scale": 2e-5}
    sigmas = {row.name: row.sigma for row in with_priors(rows, given)}
    default = {row.name: row.sigma for row in rows}
    assert "focal_left" not in sigmas
    assert sigmas["focal_right"] == 0.01
    assert sigmas["pan_zero"] == FREED_SIGMAS * default["pan_zero"]
    assert sigmas["pan_scale"] == 2e-5
    assert sigmas["stereo_r_x"] == default["stereo_r_x"]
    assert not list(with_priors(rows, {"all": 0.0}))
    assert [r.name for r in with_priors(rows, {"all": 0.0, "square_size": 1e-3})] == ["square_scale"]
