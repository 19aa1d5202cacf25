"""Measurements with the estimated constants of the robot description applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.likelihood.nuisance import camera_change, table
from mobilecal_cli.likelihood.state import State, cameras_at, head_at, points_at, wheel_clock_s
from mobilecal_cli.likelihood.views import view_rates
from mobilecal_cli.model import Camera, Extraction, Parameters, Side
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
    change = camera_change(data.layout.constants, state.constants)
    if not (change.right_late_s or change.readout_s):
        return extraction
    cameras, rates = change.apply(data.cameras), view_rates(data, state)[:, None]
    points = se3.act(data.T_c_k, points_at(data, state))
    velocity = np.cross(rates[..., :3], points) + rates[..., 3:]
    moved = []
    sides: tuple[tuple[Side, Camera], ...] = (("left", cameras.left), ("right", cameras.right))
    for k, (side, camera) in enumerate(sides):
        rows = (data.pixels[:, k, :, 1] + 0.5) / camera.height - 0.5
        late = points + change.late_s(side, rows)[..., None] * velocity
        if side == "right":
            points, late = (se3.act(se3.inverse(cameras.T_c_r), at) for at in (points, late))
        moved.append(project(camera, late) - project(camera, points))
    observations = tuple(
        replace(
            o,
            left=replace(o.left, pixels=o.left.pixels - left),
            right=replace(o.right, pixels=o.right.pixels - right),
        )
        for o, left, right in zip(extraction.observations, *moved, strict=True)
    )
    return replace(extraction, observations=observations)


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
    boards = np.broadcast_to(np.eye(4), (data.logs, 4, 4))
    state = State.without_errors(data, parameters, boards, np.zeros((data.stations, 3)))
    known = {row.name: constants[row.name] for row in rows}
    return at_state(extraction, data, replace(state, constants=known))
