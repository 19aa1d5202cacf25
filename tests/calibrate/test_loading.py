"""Extractions as input: their own settings, and those that may replace them."""

import math
import os
import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.calibrate.load import load
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.likelihood.constants import OF_RECORDINGS, table
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import WheelGeometry, WheelSource
from mobilecal_cli.rig.config import UNCONFIGURED, load_rig
from mobilecal_cli.rig.settings import refuse_others, with_settings
from mobilecal_cli.solvers import Constraints
from mobilecal_cli.solvers.inference import dataset_for
from tests.extractions import STATION_NOISE, joined, simulated


@pytest.fixture(scope="module")
def npz(tmp_path_factory):
    extraction = simulated("standard", STATION_NOISE, "tick", 8, seed=5)
    path = tmp_path_factory.mktemp("npz") / "extraction.npz"
    path.write_bytes(extraction_to_npz(replace(extraction, logs=(LogSource("log.mcap", "0" * 64),))))
    return path


def test_an_extraction_beside_a_recording_is_named(npz, sample_logs):
    said = re.escape(f"{npz}: an extraction contains its settings and cannot be combined with others")
    with pytest.raises(ConfigError, match=said):
        load([sample_logs / "straight.mcap", npz], load_rig(None))


@pytest.mark.parametrize("joints", [True, False])
def test_an_extraction_that_contains_a_recording_twice_is_refused(npz, tmp_path, joints):
    """Earlier versions wrote them, and without joints."""
    one = loaded(npz) if joints else replace(loaded(npz), joint_tracks=())
    double = replace(joined(one, one), logs=(*one.logs, LogSource("again.bag", "1" * 64)))
    (tmp_path / "double.npz").write_bytes(extraction_to_npz(double))
    with pytest.raises(ConfigError, match=r"log\.mcap and again\.bag are the same recording"):
        load([tmp_path / "double.npz"], load_rig(None))


@pytest.mark.parametrize("size", [100, 10_000])
def test_a_truncated_extraction_is_no_foreign_file(npz, tmp_path, size):
    """It was taken for a recording of an unknown format."""
    (tmp_path / "cut.npz").write_bytes(npz.read_bytes()[:size])
    with pytest.raises(RecordingError, match=r"cut\.npz: damaged: ") as caught:
        load([tmp_path / "cut.npz"], load_rig(None, {}))
    assert "calibrate from the recording" in caught.value.hint


def loaded(npz, **flags):
    flags = {key.replace("__", "."): value for key, value in flags.items()}
    return load([npz], load_rig(None, flags)).extraction


def test_priors_and_noise_replace_those_of_an_extraction(npz, tmp_path):
    rig = loaded(npz, priors__all="fixed", priors__pan_zero=0.2, noise__floor_m=0.001).rig
    names = {row.name for row in table(rig.cameras, rig.chain)}
    assert rig.prior_sigmas.keys() == names | {
        "board_corners",
        "clock",
        "floor_drift",
        "floor_shape",
        "lens_waves",
    }
    assert rig.prior_sigmas["pan_zero"] == pytest.approx(math.radians(0.2))
    assert rig.noise == {"floor_m": 0.001}
    again = tmp_path / "extraction.npz"
    again.write_bytes(extraction_to_npz(loaded(npz, priors__all="fixed", noise__floor_m=0.001)))
    kept = loaded(again, priors__focal_length="free").rig
    assert math.isinf(kept.prior_sigmas["focal_left"])
    assert kept.prior_sigmas["pan_zero"] == 0
    assert kept.noise == {"floor_m": 0.001}


def test_priors_of_a_kind_hold_for_constants_that_a_recording_has_of_its_own(npz):
    """Entries for the places of corners were accepted and ignored, and "all: fixed" left them free."""

    def of_recordings(**priors):
        layout = dataset_for(loaded(npz, **priors), Constraints()).layout
        return {row.kind: row.sigma for row in layout.constants if row.kind in OF_RECORDINGS}

    floor, others = (
        {"floor_drift": 0.001, "floor_shape": 0.001},
        {"board_corners": 0.00015, "lens_waves": 0.0002},
    )
    assert of_recordings() == pytest.approx(floor | others)
    fixed = {f"priors__{kind}": "fixed" for kind in (*floor, "lens_waves")}
    assert of_recordings(priors__board_corners=0.3, **fixed) == {"board_corners": 0.0003}


@pytest.mark.parametrize("flag", ["board.square_m", "stations", "priorsx", "wheels.left.bits"])
def test_settings_that_were_used_are_refused_with_those_that_can_change(npz, flag):
    with pytest.raises(ConfigError, match=f"{flag} cannot be changed in an extraction") as told:
        refuse_others({flag}, str(npz))
    assert "priors, noise, gates, nominal, cameras.reference, wheels.left.sign" in told.value.hint
    with pytest.raises(ConfigError, match="stations cannot be changed in an extraction"):
        loaded(npz, stations="all")
    with pytest.raises(ConfigError, match=r"priors\.pan_zer: this robot has no such constant"):
        loaded(npz, priors__pan_zer=1)


def test_sign_and_resolution_of_a_wheel_scale_its_rotation(npz, tmp_path):
    old = loaded(npz)
    source = old.rig.sources.wheels["left"]
    ticks = source.ticks_per_revolution or 2 * math.pi
    new = loaded(npz, wheels__left__sign=-1, wheels__left__ticks_per_revolution=ticks / 2)
    assert new.rig.sources.wheels["left"].sign == -1
    assert new.rig.sources.wheels["left"].ticks_per_revolution == ticks / 2
    for before, after in zip(old.wheels, new.wheels, strict=True):
        np.testing.assert_allclose(after.left.value, -2 * before.left.value, rtol=1e-12)
        np.testing.assert_array_equal(after.right.value, before.right.value)
    # The same ticks per revolution again, and the sign as before: nothing changes.
    (tmp_path / "e.npz").write_bytes(extraction_to_npz(new))
    same = loaded(tmp_path / "e.npz", wheels__left__sign=1, wheels__left__ticks_per_revolution=ticks)
    np.testing.assert_allclose(same.wheels[0].left.value, old.wheels[0].left.value, rtol=1e-14)


def test_nominal_values_and_the_reference_camera(npz):
    head_eye = {"translation_m": [0.1, 0.2, 0.3], "quaternion_xyzw": [0, 0, 0, 1]}
    wheels = {"radius_left_m": 0.08, "radius_right_m": 0.08, "separation_m": 0.35}
    rig = loaded(npz, nominal__head_eye=head_eye, nominal__wheels=wheels).rig
    assert rig.nominal.wheels == WheelGeometry(0.08, 0.08, 0.35)
    assert rig.nominal.T_h_reference[:3, 3] == pytest.approx([0.1, 0.2, 0.3])
    assert rig.setting_sources["nominal wheels"] == rig.setting_sources["nominal head_eye"] == "flag"
    again = replace(loaded(npz), rig=rig)
    turned = with_settings(again, load_rig(None, {"cameras.reference": "right"})).rig
    assert turned.cameras.reference == "right"
    expected = rig.nominal.T_h_reference @ rig.cameras.T_c_each[1]
    np.testing.assert_allclose(turned.nominal.T_h_reference, expected, atol=1e-12)
    assert turned.nominal.wheels == rig.nominal.wheels


def test_wheels_from_odometry_keep_their_sizes(npz):
    extraction = loaded(npz)
    sizes = WheelGeometry(0.08, 0.08, 0.35)
    wheels = {side: WheelSource("/odom", baked_in=sizes) for side in ("left", "right")}
    sources = replace(extraction.rig.sources, wheels=wheels)
    extraction = replace(extraction, rig=replace(extraction.rig, sources=sources))
    nominal = {"radius_left_m": 0.1, "radius_right_m": 0.1, "separation_m": 0.4}
    for flags, words in (
        ({"nominal.wheels": nominal}, "come from odometry"),
        ({"wheels.left.sign": -1}, "computed from odometry"),
    ):
        with pytest.raises(ConfigError, match=words):
            with_settings(extraction, load_rig(None, flags))


def test_a_directory_that_cannot_be_read_is_named(tmp_path):
    """It was extraction.npz in it, which nobody gave."""
    (closed := tmp_path / "closed").mkdir(mode=0)
    user = os.geteuid()
    try:
        os.seteuid(user or 65534)  # root reads all
        with pytest.raises(RecordingError, match=r"closed: cannot be read: Permission denied"):
            load([closed], UNCONFIGURED)
    finally:
        os.seteuid(user)
