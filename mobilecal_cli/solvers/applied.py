"""Measurements with the estimated constants of the robot description applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.likelihood.effects import ImageClock
from mobilecal_cli.likelihood.nuisance import table
from mobilecal_cli.likelihood.state import State, cameras_at, head_at, wheel_clock_s
from mobilecal_cli.likelihood.views import blocks_of, corner_residuals, view_rates
from mobilecal_cli.model import Extraction, Parameters
from mobilecal_cli.solvers.residuals import triangulated_again


def at_state(extraction: Extraction, data: Dataset, state: State) -> tuple[Extraction, MotionPairs]:
    """The cameras and the pairs with a state's constants applied: cameras, time offsets, head chain and joints."""
    cameras, extraction = cameras_at(data, state), _at_stamps(extraction, data, state)
    as_read = replace(state, joint_errors=np.zeros_like(state.joint_errors))
    return replace(extraction, rig=replace(extraction.rig, cameras=cameras)), replace(
        data.pairs,
        points_c=triangulated_again(extraction, cameras),
        T_v_h=head_at(data, as_read),
        steps=data.steps(wheel_clock_s(data, state)),
    )


def _at_stamps(extraction: Extraction, data: Dataset, state: State) -> Extraction:
    """The same with each corner where it was at its image's stamp, see `ImageClock`."""
    clocks = {row.name for row in data.layout.constants if isinstance(row.effect, ImageClock)}
    if not any(state.value(name) for name in clocks):
        return extraction
    T_c_k, rates = data.T_c_k, view_rates(data, state)
    prompt = replace(state, constants={k: v for k, v in state.constants.items() if k not in clocks})
    moved = list(extraction.observations)
    for block in blocks_of(data.stations):
        late, _ = corner_residuals(data, state, T_c_k[block], block, rates[block])
        shift = late - corner_residuals(data, prompt, T_c_k[block], block)[0]
        for i, (left, right) in enumerate(shift, block.start):
            o = moved[i]
            sides = (
                replace(o.left, pixels=o.left.pixels - left),
                replace(o.right, pixels=o.right.pixels - right),
            )
            moved[i] = replace(o, left=sides[0], right=sides[1])
    return replace(extraction, observations=tuple(moved))


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
