"""Measurements with the estimated constants of the robot description applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.likelihood.legs import wheel_clock_s
from mobilecal_cli.likelihood.nuisance import table
from mobilecal_cli.likelihood.state import State, cameras_at, head_at
from mobilecal_cli.model import Extraction, Parameters
from mobilecal_cli.solvers.residuals import triangulated_again


def at_state(extraction: Extraction, data: Dataset, state: State) -> tuple[Extraction, MotionPairs]:
    """The cameras and the pairs with a state's constants applied: cameras, time offsets, head chain and joints."""
    cameras = cameras_at(data, state)
    as_read = replace(state, joint_errors=np.zeros_like(state.joint_errors))
    return replace(extraction, rig=replace(extraction.rig, cameras=cameras)), replace(
        data.pairs,
        points_c=triangulated_again(extraction, cameras),
        T_v_h=head_at(data, as_read),
        steps=data.steps(wheel_clock_s(data, state)),
    )


def at_constants(
    extraction: Extraction, parameters: Parameters, constants: Mapping[str, float]
) -> tuple[Extraction, MotionPairs]:
    """The same with constants of an earlier calibration.

    Args:
        extraction: the measurements.
        parameters: the nine parameters.
        constants: name → difference from the stated value.
    """
    rig = extraction.rig
    rows = [row for row in table(rig.cameras, rig.chain) if constants.get(row.name)]
    data = dataset_of(extraction, rows)
    boards = np.broadcast_to(np.eye(4), (data.layout.boards, 4, 4))
    state = State.without_errors(data, parameters, boards, np.zeros((data.stations, 3)))
    known = {row.name: constants[row.name] for row in rows}
    return at_state(extraction, data, replace(state, constants=known))
