"""Garbage as arguments of the Python surface: an error of the package, with a sentence and a hint."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import mobilecal_cli as mc
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.export.extraction import extraction_to_npz
from tests.report.example import make_extraction

NAN, INF = math.nan, math.inf
TIMES = np.array([0.0, 1.0])
DRIVE = mc.Drive([mc.TargetPose(0.5, np.eye(4), np.eye(6))], TIMES, TIMES, TIMES)
MOTION = mc.SensorMotion(1.0, 1.0, np.array([0.1, 0, 0]), np.eye(3))
NOTHING = [None, 5, NAN, True, "x", b"x", [], [None], {5: 5}, object(), np.zeros(3)]


def but(values, *right):
    """The values that are wrong."""
    return [value for value in values if repr(value) not in {repr(each) for each in right}]


@pytest.fixture(scope="module")
def right(tmp_path_factory):
    """What the calls need that is right."""
    folder = tmp_path_factory.mktemp("garbage")
    npz = folder / "extraction.npz"
    npz.write_bytes(extraction_to_npz(make_extraction()))
    data = mc.extract(npz)
    fit = mc.solve(data)
    report = mc.Report(data, fit)
    report.save(folder / "result")
    params = folder / "result" / "params.yaml"
    return SimpleNamespace(npz=npz, data=data, fit=fit, report=report, folder=folder, params=params)


def calls():
    """(function, argument, value): everything else is right."""
    yield from (("extract", "logs", value) for value in [*NOTHING, ["x", 3], "\0", [[]], "/", "."])
    yield from (("extract", "config", value) for value in [*but(NOTHING, None), "\0", "/"])
    squares = ({"board.square_m": value} for value in ("wide", object(), np.array([1, 2])))
    pixels = ({"noise.pixel_px": value} for value in (NAN, -1))
    settings = [*but(NOTHING, None), *squares, *pixels, {"board": 5}, {"board..x": 1}, {"": 1}, {"head": []}]
    yield from (("extract", "settings", value) for value in but(settings, {}, (), [], ""))
    yield from (("extract", "progress", value) for value in NOTHING)
    yield from (("extract", "jobs", value) for value in [None, -1, 0, 2.5, NAN, "2", [], {}, object()])
    yield from (("solve", "data", value) for value in NOTHING)
    yield from (("solve", "method", value) for value in [*NOTHING, "mll", "ML", ["ml"]])
    separations = ("0.5", NAN, INF, -1, True, [0.5], np.zeros(2), 1j, object())
    fixes = [
        *but(NOTHING, None, []),
        *([None], [[]], {5: 5}, object(), np.zeros(3), {"wheels": 0.5}, {None: 0.5}, {"": None}),
        *({"separation": value} for value in separations),
    ]
    yield from (("solve", "fix", value) for value in but(fixes, ""))
    pairs = ((), (0.5,), (0.5, -1), (0.5, 0), (0.5, NAN), (NAN, 1), ("0.5", "0.1"), (1, 2, 3))
    priors = [
        *but(NOTHING, None, []),
        *([None], {5: 5}, "separation=0.5±0.1", {"seperation": (0.5, 0.1)}),
        *({"separation": value} for value in (0.5, "ab", None, {}, *pairs)),
    ]
    yield from (("solve", "prior", value) for value in but(priors, ""))
    estimates = [*but(NOTHING, []), [None], [5], [[]], [""], ",,,", "streo"]
    yield from (("solve", "estimate", value) for value in estimates)
    shares = [NAN, INF, -1, 0, 1, 5, "0.3", [], [0.3], {}, True, 1j]
    yield from (("solve", "hold_out", value) for value in shares)
    yield from (("solve", "progress", value) for value in NOTHING)
    yield from (("Report", "data", value) for value in NOTHING)
    yield from (("Report", "fit", value) for value in NOTHING)
    gates = [
        *but(NOTHING, []),
        *([None], ["stations"], "stations=5", {5: 5}, {"nope": 1}, {"hold_out.stations": 1}, object()),
        *({"stations": value} for value in ("5", None, NAN, [])),
    ]
    yield from (("Report", "gates", value) for value in but(gates, "", None))
    yield from (("Report", "last", value) for value in [*but(NOTHING, None), "\0", "/"])
    yield from (("save", "directory", value) for value in but([*NOTHING, "\0", "/"], "x"))
    yield from (("compare", "first", value) for value in NOTHING)
    yield from (("compare", "second", value) for value in [*NOTHING, "params.yaml"])
    yield from (("load", "params", value) for value in [*NOTHING, "\0", "/"])
    yield from (("export_to", "params", value) for value in [*NOTHING, "\0", "/"])
    yield from (("export_to", "target", value) for value in [*NOTHING, "xarco"])
    yield from (("export_to:urdf", "urdf", value) for value in [*NOTHING, "\0", "/"])
    joints = [*but(NOTHING, None), {"middle": "x"}, {"left": 5}, {"left": ""}, {5: "x"}, ["left"]]
    yield from (("export_to:ros2_control", "wheel_joints", v) for v in but(joints, {}, (), [], ""))
    numbers = [*but(NOTHING, None), -1, 0, INF, "5"]
    yield from (("export_to:odometry_covariance", "rate_hz", value) for value in but(numbers, 5, 2.5))
    yield from (("export_to:odometry_covariance", "distance_m", v) for v in but(numbers, 5, 2.5))
    yield from (("export_to:foxglove", "logs", v) for v in but([*NOTHING, "\0"], [], (), {}))
    for function, whole in (("from_poses", "drives"), ("from_motions", "motions")):
        yield from ((function, whole, value) for value in NOTHING)
        yield from ((function, "wheels_m", value) for value in [*NOTHING, (0.1, 0.1), "abc", (100, 100, 500)])
        levels = ({"wheel": 0.1}, {"pixel_px": -1}, {"pixel_px": "x"})
        yield from ((function, "noise", value) for value in [*but(NOTHING, None, []), *levels])
    yield from (("from_poses", "chain", value) for value in but(NOTHING, None))
    yield from (("from_poses", "T_h_c", value) for value in but(NOTHING, None))
    yield from (("from_motions", "T_v_c", value) for value in NOTHING)
    yield from (("Drive", name, value) for name in ("poses", "right_rad") for value in NOTHING)
    yield from (("TargetPose", name, v) for name in ("T_c_k", "covariance") for v in NOTHING)
    yield from (("TargetPose", "time_s", value) for value in but(NOTHING, 5))
    yield from (("TargetPose", "joints", value) for value in but(NOTHING, None))
    yield from (("SensorMotion", name, None) for name in ("right_rad", "motion", "covariance"))
    yield from (("Data", "extraction", value) for value in NOTHING)


CALLS = list(calls())


def called(right, function, argument, value):
    function, _, target = function.partition(":")
    given = {
        "extract": {"logs": right.npz},
        "solve": {"data": right.data},
        "Report": {"data": right.data, "fit": right.fit},
        "compare": dict.fromkeys(("first", "second"), right.report.robot),
        "export_to": {"params": right.params, "target": target or "json"},
        "from_poses": {"drives": [DRIVE], "wheels_m": (0.1, 0.1, 0.5)},
        "from_motions": {"motions": [MOTION], "wheels_m": (0.1, 0.1, 0.5), "T_v_c": np.eye(4)},
    }
    if function == "Drive":
        return mc.from_poses([replace(DRIVE, **{argument: value})], (0.1, 0.1, 0.5))
    if function == "TargetPose":
        drive = replace(DRIVE, poses=[replace(DRIVE.poses[0], **{argument: value})])
        return mc.from_poses([drive], (0.1, 0.1, 0.5))
    if function == "SensorMotion":
        return mc.from_motions([replace(MOTION, **{argument: value})], (0.1, 0.1, 0.5), np.eye(4))
    call = right.report.save if function == "save" else getattr(mc, function)
    return call(**given.get(function, {}) | {argument: value})


@pytest.mark.parametrize(
    ("function", "argument", "value"),
    CALLS,
    ids=[f"{n}-{function}-{argument}" for n, (function, argument, _) in enumerate(CALLS)],
)
def test_garbage(right, monkeypatch, function, argument, value):
    monkeypatch.chdir(right.folder)
    before = sorted(right.folder.iterdir())
    with pytest.raises(MobilecalError) as caught:
        called(right, function, argument, value)
    text = str(caught.value)
    assert len(text.split()) >= 3, text
    assert len(text) < 1000, text
    assert caught.value.hint
    assert sorted(right.folder.iterdir()) == before
