"""Boards with markers through the whole product."""

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli.calibrate import inspect, steps
from mobilecal_cli.rig.config import load_rig, parse_settings
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.simulate.scenario import PRINTED, Scenario
from tests.truth import nees


@pytest.mark.parametrize("kind", [pytest.param("charuco", marks=pytest.mark.slow), "aprilgrid"])
@pytest.mark.long
def test_a_board_with_markers_that_leaves_the_pictures(kind, tmp_path):
    """The board is larger than most pictures show: a checkerboard of its size would hardly be seen."""
    log, board, scenario = tmp_path / "log.mcap", PRINTED[kind], Scenario(kind=kind, seed=2)
    simulate(scenario, log)
    config = load_rig(None, parse_settings(f"{key}={value}" for key, value in scenario.unrecorded().items()))
    found = steps.calibrate([log], tmp_path / "out", config=config)
    seen = [corners.seen for o in found.fit.extraction.observations for corners in (o.views[0], o.views[1])]
    assert len(seen) >= 2 * 9
    assert np.mean([mask.all() for mask in seen]) < 0.2
    assert nees(found.fit.parameters, found.fit.covariance, PAPER_ROBOT) < 2.5
    assert found.verdict.level == "PASS"
    params = YAML(typ="safe").load((tmp_path / "out" / "params.yaml").read_text())
    assert params["provenance"]["config"]["board"]["kind"] == kind
    again = steps.calibrate([tmp_path / "out" / "extraction.npz"], tmp_path / "again")
    np.testing.assert_allclose(
        again.fit.solution.parameters.T_h_c, found.fit.solution.parameters.T_h_c, atol=1e-9
    )
    if kind == "aprilgrid":
        view = inspect.inspect([log], config).board
        assert view.size == (board.columns, board.rows)
        assert view.seen >= 9
