"""Noise of the joint readings, which must not look like motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model import Track
from tests.bench import imperfect

NOISE_RAD = np.radians(0.2)


def noisy_track(of, random):
    return Track(of.time_ns, of.value + NOISE_RAD * random.normal(size=len(of.value)))


def test_noise_of_the_readings_is_no_motion_within_a_clocks_offset():
    exact = imperfect.Case(motion="moving", noise=replace(imperfect.PERFECT, joint_rad=0.0)).extraction(0)
    random = np.random.default_rng(0)
    tracks = tuple(noisy_track(track, random) for track in exact.joint_tracks[0])
    noisy = replace(exact, joint_tracks=(tracks,))
    moved, without = (dataset_of(each).joint_shift(0.02) for each in (noisy, exact))
    by_noise = moved - without
    assert np.abs(by_noise).max() < NOISE_RAD / 2
    assert np.abs(by_noise).mean() > 0
    smooth = dataset_of(exact).joint_tracks[0]
    assert all(np.array_equal(a.value, b.value) for a, b in zip(smooth, exact.joint_tracks[0], strict=True))


def test_a_robot_in_motion_with_noisy_joints_passes():
    """At a quarter of the verdict's limit: it was refused, or a board that nobody touched had moved by 1.8 m."""
    case = imperfect.Case(motion="moving", noise=replace(imperfect.USUAL, joint_rad=np.radians(0.1))).drawn()
    run = imperfect.run_of_case(case, 3)
    assert run.level == "PASS"
    assert not run.jumps
    assert run.nees[3] < 3
