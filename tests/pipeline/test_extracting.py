"""Recordings of one robot whose camera infos differ."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mobilecal_cli.model import CAMERA_INFO_CHANGES
from mobilecal_cli.pipeline.extracting import _other_cameras
from mobilecal_cli.simulate.robot import ROBOTS

CAMERAS = ROBOTS["paper"]().rig_cameras


def seen(name, cameras):
    return SimpleNamespace(name=name, rig=SimpleNamespace(cameras=cameras))


def changed(**fields):
    return replace(CAMERAS, right=replace(CAMERAS.right, **fields))


@pytest.mark.parametrize(
    "other",
    [
        changed(K=CAMERAS.right.K * np.array([[1.001], [1.001], [1]])),
        changed(D=CAMERAS.right.D + 0.01),
        changed(D=np.zeros(8), distortion="rational_polynomial"),
        replace(CAMERAS, T_c_r=CAMERAS.T_c_r + 1e-4),
    ],
)
def test_other_cameras_are_told(other):
    (note,) = _other_cameras(seen("a.mcap", CAMERAS), seen("b.mcap", other))
    assert note.startswith(f"b.mcap: {CAMERA_INFO_CHANGES} from that of a.mcap")


def test_rounding_is_not_told():
    other = changed(K=CAMERAS.right.K * (1 + 1e-9), D=CAMERAS.right.D + 1e-9)
    assert _other_cameras(seen("a.mcap", CAMERAS), seen("b.mcap", other)) == ()
