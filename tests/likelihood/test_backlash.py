"""The search for a joint's last motion, against looking at every value before every station."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model import Track
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.simulate.route import plan_route
from tests.extractions import extraction_of


def approach_direction(extraction):
    return dataset_of(extraction).approach_direction


ROUTE = plan_route(paper_robot(), "standard", stations=6, seed=0)
EXTRACTION = extraction_of(paper_robot(), ROUTE)


def mean(track, at):
    """Over 40 ms."""
    ends = at - 20_000_000, at + 20_000_000
    inside = track.time_ns[(track.time_ns > ends[0]) & (track.time_ns < ends[1])]
    knots = np.array([ends[0], *inside, ends[1]])
    values = track.at(knots)
    return np.sum(np.diff(knots) * (values[1:] + values[:-1]) / 2) / 40_000_000


def plain(extraction):
    sides = []
    for o in extraction.observations:
        for j, track in enumerate(extraction.joint_tracks[o.log]):
            earlier = track.value[track.time_ns < o.time_ns]
            away = earlier[np.abs(earlier - o.joints[j]) > 0.002]
            moments = o.time_ns + np.array([-150, -50, 0, 50, 150]) * 1_000_000
            long_ago, before, here, after, later = (mean(track, at) for at in moments)
            last = np.sign(o.joints[j] - away[-1]) if len(away) else 0.0
            turns = min(abs(long_ago - here), abs(later - here)) > 0.002
            own = np.clip((after - before) / 0.1 / 0.03, -1, 1)
            sides.append(own if abs(here - before) / 0.05 > 0.03 or turns else last)
    return np.array(sides).reshape(len(extraction.observations), -1)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
@settings(max_examples=60, deadline=None)
def test_as_by_looking_at_every_value(seed, length):
    """Tracks that begin late, end early, rest, and move by about the least motion that counts."""
    random = np.random.default_rng(seed)
    first, last = EXTRACTION.observations[0].time_ns, EXTRACTION.observations[-1].time_ns
    tracks = []
    for _ in EXTRACTION.rig.chain.joints:
        at = np.unique(random.integers(first - 10**9, last + 10**9, length))
        tracks.append(Track(at, np.cumsum(random.choice([0.0, 0.0015, -0.0015, 0.3], len(at)))))
    observations = tuple(
        dataclasses.replace(o, joints=random.choice(np.concatenate([t.value for t in tracks]), len(o.joints)))
        for o in EXTRACTION.observations
    )
    changed = dataclasses.replace(EXTRACTION, observations=observations, joint_tracks=(tuple(tracks),))
    np.testing.assert_allclose(approach_direction(changed), plain(changed), atol=1e-9)


def test_a_joint_that_turns_back_at_a_station_is_on_neither_side():
    o = EXTRACTION.observations[2]
    at = o.time_ns + np.arange(-40, 41) * 10_000_000
    back = Track(at, 0.5 * ((at - o.time_ns) * 1e-9) ** 2)
    tracks = (back, *EXTRACTION.joint_tracks[0][1:])
    sides = approach_direction(dataclasses.replace(EXTRACTION, joint_tracks=(tracks,)))
    assert abs(sides[2, 0]) < 0.1


def test_the_side_of_a_joint_that_just_turned_back_is_uncertain():
    """In motion, by the prior of its play; at rest it is known, and so is that of a joint that moves on."""
    o = EXTRACTION.observations[2]
    at = o.time_ns + np.arange(-40, 41) * 10_000_000
    turned, on = (Track(at, way) for way in (0.5 * ((at - o.time_ns) * 1e-9) ** 2, 0.5 * (at - at[0]) * 1e-9))
    tracks = (turned, on, *EXTRACTION.joint_tracks[0][2:])
    joints = np.array([track.at(np.array([o.time_ns]))[0] for track in tracks])
    for at_rest, sigma in ((False, np.radians(0.1)), (True, 0.0)):
        stations = list(EXTRACTION.observations)
        stations[2] = dataclasses.replace(o, at_rest=at_rest, joints=joints)
        made = dataclasses.replace(EXTRACTION, observations=tuple(stations), joint_tracks=(tracks,))
        between = dataset_of(made).joints_between[2]
        assert between[0] == pytest.approx(sigma, rel=0.01)
        assert between[1] < 1e-6


def test_a_route_comes_from_both_sides():
    sides = approach_direction(EXTRACTION)
    np.testing.assert_allclose(sides, plain(EXTRACTION), atol=1e-9)
    assert {-1.0, 1.0} <= set(sides.ravel())
    assert not approach_direction(dataclasses.replace(EXTRACTION, joint_tracks=())).any()
