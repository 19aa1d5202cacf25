"""Simulated recordings through the whole product: exact ones to the accuracy of the light."""

import json
import re

import pytest

from tests.command import succeeded
from tests.commands.test_calibrate import assert_near, load


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """The paper's robot without any noise."""
    place = tmp_path_factory.mktemp("logs")
    succeeded("simulate", "exact.mcap", "--exact", "--pictures", "png", "--seed", "1", cwd=place)
    return place


@pytest.mark.parametrize("method", ["linear", "lm"])
@pytest.mark.long
def test_pictures_without_noise_and_exact_encoders(exact, tmp_path, method):
    succeeded("calibrate", exact / "exact.mcap", "--method", method, "--output", "out", cwd=tmp_path)
    # Asked for: 0.1 degrees, 2 mm, 0.15 %. Measured: 0.003 degrees, 0.13 mm, 0.005 %.
    assert_near(tmp_path / "out/params.yaml", exact / "exact.truth.yaml", 0.01, 0.5, 0.015)


@pytest.mark.long
def test_a_log_that_never_rests(tmp_path_factory, tmp_path):
    log = tmp_path_factory.mktemp("logs") / "moving.mcap"
    moving = ("--motion", "moving", "--stations", "4", "--camera-late", "0.025")
    succeeded("simulate", log, "--exact", *moving, cwd=tmp_path)
    result = succeeded("calibrate", log, "--output", "out", "-v", cwd=tmp_path)
    for clock in ("joints", "wheels"):
        assert re.search(rf"time_{clock} .* -2[45]\.\d+ +0\.\d+ .*ms", result.out), result.out
    assert_near(tmp_path / "out/params.yaml", log.with_name("moving.truth.yaml"), 0.3, 6, 0.3)
    quality = load(tmp_path / "out/params.yaml")["quality"]
    assert quality["stations"] > 30
    assert quality["point_rms_mm"] < 5
    extras = json.loads((tmp_path / "out/report.json").read_text())["constants"]
    for clock in ("time_joints", "time_wheels"):
        assert extras[clock]["value"] == pytest.approx(-0.025, abs=max(0.0005, 4 * extras[clock]["std"]))
