"""Extractions as input: their own settings, and those that may replace them."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from mobilecal_cli.config import load_rig
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export import extraction_to_npz
from mobilecal_cli.likelihood.nuisance import table
from mobilecal_cli.model import LogSource
from mobilecal_cli.pipeline.loading import load
from mobilecal_cli.pipeline.progress import silent
from mobilecal_cli.simulate.imperfect import STATION_NOISE, Imperfection, imperfect_extraction
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import solve


@pytest.fixture(scope="module")
def npz(tmp_path_factory):
    robot = ROBOTS["tick"]()
    route = plan_route(robot, "standard", 8, seed=5)
    extraction = imperfect_extraction(robot, route, Imperfection(noise=STATION_NOISE), seed=2)
    path = tmp_path_factory.mktemp("npz") / "extraction.npz"
    path.write_bytes(extraction_to_npz(replace(extraction, logs=(LogSource("log.mcap", "0" * 64),))))
    return path


def loaded(npz, **flags):
    flags = {key.replace("__", "."): value for key, value in flags.items()}
    return load([npz], load_rig(None, flags), None, flags, silent)[0]


def test_priors_and_noise_replace_those_of_an_extraction(npz, tmp_path):
    rig = loaded(npz, priors__all="fixed", priors__pan_zero=0.2, noise__floor_m=0.001).rig
    assert rig.prior_sigmas.keys() == {row.name for row in table(rig.cameras, rig.chain)}
    assert rig.prior_sigmas["pan_zero"] == pytest.approx(math.radians(0.2))
    assert rig.noise.given == {"floor_m": 0.001}
    again = tmp_path / "extraction.npz"
    again.write_bytes(extraction_to_npz(loaded(npz, priors__all="fixed", noise__floor_m=0.001)))
    kept = loaded(again, priors__focal_length="free").rig
    assert math.isinf(kept.prior_sigmas["focal_left"])
    assert kept.prior_sigmas["pan_zero"] == 0
    assert kept.noise.given == {"floor_m": 0.001}


def test_the_solver_uses_them(npz):
    assert solve(loaded(npz, priors__all="fixed")).constants.keys() <= {"square_scale"}
    usual = solve(loaded(npz))
    narrow = solve(loaded(npz, priors__focal_length=0.0005))
    assert narrow.constants["focal_left"].prior == pytest.approx(5e-6)
    assert narrow.constants["focal_left"].std < 5.05e-6 < usual.constants["focal_left"].std


@pytest.mark.parametrize("flag", ["board.square_m", "stations", "priorsx"])
def test_other_settings_are_refused(npz, flag):
    with pytest.raises(ConfigError, match="an extraction contains its settings"):
        load([npz], load_rig(None), None, {flag: "all"}, silent)


def test_unknown_constants_are_refused(npz):
    with pytest.raises(ConfigError, match=r"priors\.pan_zer: this robot has no such constant"):
        loaded(npz, priors__pan_zer=1)
