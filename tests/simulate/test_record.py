"""Recordings: the same values in every container, the same bytes from the same seed, and no partial output."""

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli.errors import OutputError
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.readers import open_recording, read_description, read_images, read_signals
from mobilecal_cli.rig.config import load_rig, parse_settings
from mobilecal_cli.se3 import from_quaternion_xyzw
from mobilecal_cli.simulate.record import START_NS, simulate, truth_path
from mobilecal_cli.simulate.robot import JOINT_NOISE_RAD, ROBOTS, urdf_text
from mobilecal_cli.simulate.route import base_in_world
from mobilecal_cli.simulate.scenario import Scenario, World
from mobilecal_cli.targets import Container
from tests.robots import sources_of

SMALL = Scenario(stations=2, pictures_per_rest=1, seed=4)
SUFFIXES = {"mcap": ".mcap", "bag": ".bag", "rosbag2": ""}


def recorded(folder: Path, scenario: Scenario) -> Path:
    out = folder / f"log{SUFFIXES[scenario.container.split('-')[0]]}"
    simulate(scenario, out)
    return out


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def contents(path: Path, scenario: Scenario):
    """Everything that a calibration reads: robot description, signals and decoded images."""
    robot = ROBOTS[scenario.robot]
    sources = sources_of(robot, compressed=scenario.pictures != "mono8")
    with open_recording([path]) as recording:
        description = read_description(recording)
        (signals,) = read_signals(recording, sources)
        found = read_images(recording, sources, signals.images)
        pictures = {f"{side} {stamp}": image for side, stamp, image in found}
    return description, signals, pictures


def flat(value):
    """A nested value as (name, array or plain value) pairs."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from ((f"{key}.{name}", part) for name, part in flat(inner))
    elif isinstance(value, list | tuple):
        for i, inner in enumerate(value):
            yield from ((f"{i}.{name}", part) for name, part in flat(inner))
    elif hasattr(value, "__dataclass_fields__"):
        yield from flat({name: getattr(value, name) for name in value.__dataclass_fields__})
    else:
        yield "", value


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """The recording of a scenario in a directory of its own, for tests that leave it as it is."""
    return cache(lambda scenario: recorded(tmp_path_factory.mktemp("once"), scenario))


@pytest.fixture
def copied(once, tmp_path):
    """The recording of a scenario in the test's own directory."""

    def copy(scenario: Scenario) -> Path:
        source = once(scenario)
        shutil.copytree(source.parent, tmp_path, dirs_exist_ok=True)
        return tmp_path / source.name

    return copy


@pytest.fixture(scope="module")
def reference(once):
    return contents(once(SMALL), SMALL)


@pytest.mark.parametrize("container", [container for container in get_args(Container) if container != "mcap"])
def test_every_container_holds_the_same_values(once, reference, container):
    scenario = replace(SMALL, container=container)
    description, signals, pictures = contents(once(scenario), scenario)
    same_parts = ((description.infos, reference[0].infos), (signals, reference[1]), (pictures, reference[2]))
    for found, expected in same_parts:
        pairs, wanted = list(flat(found)), list(flat(expected))
        assert [name for name, _ in pairs] == [name for name, _ in wanted]
        for (name, value), (_, same) in zip(pairs, wanted, strict=True):
            assert np.array_equal(value, same), name
    assert description.urdfs == reference[0].urdfs == {"/robot_description": urdf_text(ROBOTS["paper"])}
    assert signals.notes == ()


@pytest.mark.parametrize("container", ["mcap", "bag", "rosbag2"])
def test_the_same_scenario_gives_the_same_bytes(once, tmp_path, container):
    scenario = replace(SMALL, container=container)
    assert files(once(scenario).parent) == files(recorded(tmp_path, scenario).parent)


def test_readings_are_the_truth_within_the_stated_noise(reference):
    robot, route = SMALL.plan()
    _, signals, _ = reference
    wheels_of = {"right": 0, "left": 1}
    for i, name in enumerate(robot.joint_names):
        track = signals.joints[name]
        error = track.value - route.joints((track.time_ns - START_NS) / 1e9)[:, i]
        assert np.std(error) == pytest.approx(JOINT_NOISE_RAD, rel=0.15)
        assert abs(np.mean(error)) < 4 * JOINT_NOISE_RAD / np.sqrt(len(error))
    for side, column in wheels_of.items():
        track = signals.wheels[side]
        steps = track.value / robot.encoder_step_rad
        assert steps == pytest.approx(np.round(steps), abs=1e-6)
        exact = route.drive.wheel_angles((track.time_ns - START_NS) / 1e9, robot.wheels)[:, column]
        travelled = np.sum(np.abs(np.diff(exact)))
        error = track.value - exact
        assert np.ptp(error) < robot.encoder_step_rad + 8 * 0.003 * np.sqrt(travelled)
    begin, end = route.rests_s.T
    for side in wheels_of:
        times_s = (signals.images[side].time_ns - START_NS) / 1e9
        assert np.all(np.any((times_s[:, None] > begin + 0.2) & (times_s[:, None] < end - 0.2), axis=1))


def test_an_exact_recording_has_the_exact_readings(tmp_path):
    scenario = replace(SMALL, exact=True, pictures="mono8")
    robot, route = scenario.plan()
    _, signals, pictures = contents(recorded(tmp_path, scenario), scenario)
    for i, name in enumerate(robot.joint_names):
        track = signals.joints[name]
        assert track.value == pytest.approx(route.joints((track.time_ns - START_NS) / 1e9)[:, i], abs=1e-8)
    for side, column in (("right", 0), ("left", 1)):
        track = signals.wheels[side]
        exact = route.drive.wheel_angles((track.time_ns - START_NS) / 1e9, robot.wheels)[:, column]
        assert track.value == pytest.approx(exact, abs=1e-6)
        # Every change of speed is among the readings: 1e9 ns a second, stamps rounded to 1 ns.
        breaks_ns = START_NS + np.round(route.drive.breaks_s * 1e9).astype(np.int64)
        assert np.all(np.isin(breaks_ns[:-1], track.time_ns))
    assert len(pictures) == 2 * len(route.rests_s)


def test_tick_counters_wrap_and_are_read_as_the_wheels_angles(once):
    scenario = replace(SMALL, robot="tick")
    robot, route = scenario.plan()
    path = once(scenario)
    with open_recording([path]) as recording:
        counts = [m.decode().data for m in recording.messages(["/wheel_ticks/left"])]
    _, signals, _ = contents(path, scenario)
    assert all(0 <= count < 2**16 for count in counts)
    track = signals.wheels["left"]
    exact = route.drive.wheel_angles((track.time_ns - START_NS) / 1e9, robot.wheels)[:, 1]
    travelled = np.sum(np.abs(np.diff(exact)))
    assert np.abs(track.value - exact).max() < 2 * robot.encoder_step_rad + 8 * 0.003 * np.sqrt(travelled)
    # 500 ticks below the wrap: it comes within an eighth of a turn forward.
    assert (np.max(np.abs(np.diff(counts))) > 2**15) == (exact.max() - exact[0] > 0.78)


@pytest.mark.long
def test_a_moving_route_is_seen_ten_times_a_second_with_both_cameras_at_once(tmp_path):
    scenario = Scenario(motion="moving", stations=1)
    _, signals, _ = contents(recorded(tmp_path, scenario), scenario)
    left, right = (signals.images[side].time_ns for side in ("left", "right"))
    assert np.array_equal(left, right)
    assert np.diff(left) == pytest.approx(1e8, abs=1)
    assert len(left) >= 20  # three seconds, less half a second at each end
    for side in ("left", "right"):
        track = signals.wheels[side]
        assert track.value[-1] != track.value[0]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_urdf_draws_the_head_chain_and_the_nominal_wheels(name):
    robot = ROBOTS[name]
    urdf = parse_urdf(urdf_text(robot))
    path = urdf.path(robot.base_frame, robot.head_frame)
    assert tuple(joint.name for joint in path if joint.name in robot.joint_names) == robot.joint_names
    nominal = robot.nominal_wheels
    links = {side: [urdf.joints[name].child for name in names] for side, names in robot.wheel_joints.items()}
    radii = {side: {urdf.cylinder_radius_m[link] for link in each} for side, each in links.items()}
    assert radii == {"left": {nominal.radius_left_m}, "right": {nominal.radius_right_m}}


def test_the_truth_holds_the_nine_numbers_and_the_stations(once):
    robot, route = SMALL.plan()
    truth = truth_of(once(SMALL))
    assert truth["schema_version"] == 1
    assert truth["head_eye"]["parent_frame"] == "head_link"
    assert truth["head_eye"]["child_frame"] == "stereo_left_optical"
    assert truth["head_eye"]["translation_m"] == pytest.approx(robot.T_h_c[:3, 3], abs=1e-12)
    rotation = from_quaternion_xyzw(np.array(truth["head_eye"]["quaternion_xyzw"]))
    assert rotation == pytest.approx(robot.T_h_c[:3, :3], abs=1e-11)
    # The paper's Table 1.
    assert truth["wheels"] == {"radius_left_m": 0.22767, "radius_right_m": 0.2233, "separation_m": 0.5087}
    assert truth["board"] == {"columns": 9, "rows": 6, "square_m": 0.08}
    assert truth["scenario"]["seed"] == 4
    assert len(truth["stations"]) == len(route.rests_s)
    # The stations explain themselves: the board stays where it is.
    T_w_k = np.vstack([np.reshape(truth["board_in_world"], (3, 4)), [0, 0, 0, 1]])
    for station, times in zip(truth["stations"], route.rests_s, strict=True):
        assert times[0] < station["time_s"] < times[1]
        base = base_in_world(np.array([station["base"]]))[0]
        seen = np.linalg.inv(base @ robot.head_pose(np.array(station["joints_rad"])) @ robot.T_h_c) @ T_w_k
        assert 1 < seen[2, 3] < 3


def truth_of(out: Path):
    return YAML(typ="safe", pure=True).load(truth_path(out).read_text(encoding="utf-8"))


def test_what_is_there_is_refused_before_any_work(tmp_path):
    out = tmp_path / "log.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(OutputError, match="already exists"):
        simulate(SMALL, out)
    out.unlink()
    truth_path(out).write_text("precious")
    with pytest.raises(OutputError, match=r"log\.truth\.yaml: already exists"):
        simulate(SMALL, out)
    with pytest.raises(OutputError, match="is not a directory"):
        simulate(SMALL, tmp_path / "absent" / "log.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["log.truth.yaml"]
    for name in (".", "/"):
        with pytest.raises(OutputError, match="not the name of a recording"):
            simulate(SMALL, Path(name))


def test_force_replaces_a_recording_but_never_what_is_none(tmp_path, copied):
    scenario = replace(SMALL, container="rosbag2")
    out = copied(scenario)
    before = truth_path(out).read_bytes()
    simulate(replace(scenario, seed=5), out, force=True)
    assert truth_path(out).read_bytes() != before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "log.truth.yaml"]
    (out / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        simulate(scenario, out, force=True)
    with pytest.raises(OutputError, match="not a regular file"):
        simulate(SMALL, out, force=True)
    assert (out / "thesis.tex").read_text() == "precious"
    # Nor what was not simulated.
    out = copied(SMALL)
    truth_path(out).unlink()
    before = out.read_bytes()
    with pytest.raises(OutputError, match=r"not written by mobilecal simulate: there is no log\.truth\.yaml"):
        simulate(SMALL, out, force=True)
    assert out.read_bytes() == before


@pytest.mark.parametrize(("container", "existing"), [("mcap", True), ("bag", False), ("rosbag2", True)])
def test_a_failure_leaves_everything_as_it_was(tmp_path, copied, monkeypatch, container, existing):
    scenario = replace(SMALL, container=container)
    if existing:
        copied(scenario)
    before = files(tmp_path)

    def full(*_: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(World, "truth", full)
    with pytest.raises(OutputError, match="No space left on device"):
        simulate(scenario, tmp_path / f"log{SUFFIXES[container]}", force=True)
    assert files(tmp_path) == before
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("scenario", "keys"),
    [
        (Scenario(), set()),
        (Scenario(robot="rgbd"), {"board.square_m"}),
        (Scenario(robot="tick"), {"wheels.left.ticks_per_revolution", "wheels.right.ticks_per_revolution"}),
    ],
)
def test_what_no_recording_contains(scenario, keys):
    settings = scenario.unrecorded()
    assert settings.keys() == keys
    load_rig(None, parse_settings(f"{key}={value}" for key, value in settings.items()))
