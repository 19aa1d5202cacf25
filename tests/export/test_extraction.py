import dataclasses
import io
import json
import math
import zipfile
from dataclasses import replace
from types import NoneType, UnionType
from typing import Annotated, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from mobilecal_cli import __version__
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.export.extraction import (
    SCHEMA_VERSION,
    THUMBNAILS,
    extraction_from_npz,
    extraction_to_npz,
    snapshots_from_npz,
)
from mobilecal_cli.model.arrays import element_of
from mobilecal_cli.model.observations import Corners, Extraction, Snapshot
from mobilecal_cli.model.rig import Camera
from tests.report.example import make_extraction, make_hostile

NUMBERS = [0.0, -0.0, 5e-324, 1 / 3, -1e11, 1e11]  # what is beyond is refused as damage
TEXTS = ["", "left", "a # 'b' \"c\" {{d}}", "\x00\x1b[31m\u202e", "\udcff", "\u00e4\U0001f916"]


class Anything:
    """Values of any of the model's types, by its hints: of every field, to the ends of its range.

    Args:
        seed: of all values.
    """

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.sizes: dict[str, int] = {}  # of the arrays: the same in the whole extraction

    def few(self, of, least=0):
        """A tuple of up to two values; half of them are empty, so that a type that contains itself ends."""
        return tuple(self.of(of) for _ in range(max(self.random.choice([0, 0, 1, 2]), least)))

    def array(self, dtype, shape):
        size = [
            self.sizes.setdefault(n, int(self.random.integers(1, 6))) if isinstance(n, str) else n
            for n in shape
        ]
        if dtype is np.float64:
            return self.random.choice([*NUMBERS, *self.random.normal(size=6)], size)
        return self.random.integers(0, 2, size).astype(dtype)

    def of(self, hint):
        kind, of = get_origin(hint), get_args(hint)
        if dataclasses.is_dataclass(hint):
            return getattr(self, hint.__name__, self.value)(hint)
        if kind is Annotated:
            shape = [size for size in hint.__metadata__ if isinstance(size, int | str)]
            return self.array(element_of(hint.__origin__), shape or [3])
        if kind in (Union, UnionType):
            return self.of(of[self.random.integers(len(of))])
        if kind is Literal:
            return of[self.random.integers(len(of))]
        if kind is tuple:
            return self.few(of[0])
        if kind is not None:  # a mapping
            return dict(zip(self.few(of[0]), self.few(of[1], 2), strict=False))
        return {
            NoneType: lambda: None,
            bool: lambda: bool(self.random.integers(2)),
            int: lambda: int(self.random.integers(-(2**63), 2**63 - 1)),
            float: lambda: float(self.array(np.float64, ())),
            str: lambda: str(self.random.choice(TEXTS)),
        }[hint]()

    def value(self, cls, **given):
        hints = get_type_hints(cls, include_extras=True)
        return cls(**{f.name: given.get(f.name) or self.of(hints[f.name]) for f in dataclasses.fields(cls)})

    def Track(self, cls):
        n = int(self.random.integers(1, 6))
        return cls(np.sort(np.append(self.random.integers(1, 2**62, n), 0)), self.array(np.float64, [n + 1]))

    def Camera(self, cls):
        self.sizes.pop("n", None)
        return self.value(cls)

    def CameraRig(self, cls):
        pair = {"names": ("left", "right"), "each": (self.of(Camera), self.of(Camera)), "reference": "right"}
        self.sizes["C"] = 2
        return self.value(cls, **pair)

    def Rig(self, cls):
        return self.value(cls, prior_sigmas={"focal_left": math.inf, "clock": self.of(float)})

    def Observation(self, cls):
        return self.value(cls, views=(self.of(Corners), self.of(Corners)))

    def Extraction(self, cls):
        made = replace(self.value(cls), motions=())  # which only notebooks have
        count = len(made.wheels)
        stations = (replace(o, log=o.log % count) for o in made.observations * bool(count))
        return replace(made, observations=tuple(sorted(stations, key=lambda o: (o.log, o.time_ns))))


def assert_same(a, b, where="extraction"):
    """Equal in every field, of the same types, to the last bit."""
    assert type(a) is type(b), where
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), where
        assert a.flags.writeable == b.flags.writeable, where
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{i}]")
    elif isinstance(a, dict):
        assert list(a) == list(b), where
        for key, value in a.items():
            assert_same(value, b[key], f"{where}.{key}")
    else:
        assert repr(a) == repr(b), where  # repr tells -0.0 from 0.0


def content_of(data):
    """Name → array of a file, with the header as a dictionary."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        content = dict(archive)
    return content | {"header": json.loads(content["header"].tobytes())}


def written(content):
    """The file with some arrays."""
    if isinstance(content.get("header"), dict):
        content = content | {"header": np.frombuffer(json.dumps(content["header"]).encode(), dtype=np.uint8)}
    stream = io.BytesIO()
    np.savez(stream, **content)
    return stream.getvalue()


def usual():
    return content_of(extraction_to_npz(make_extraction(n=2)))


def with_header(change):
    """A sound file whose header was changed."""
    content = usual()
    change(content["header"])
    return written(content)


@pytest.mark.parametrize("seed", range(60))
def test_every_field_comes_back(seed):
    extraction = Anything(seed).of(Extraction)
    data = extraction_to_npz(extraction)
    assert_same(extraction, extraction_from_npz(data))
    assert extraction_to_npz(extraction) == data


@pytest.mark.parametrize("change", [{"log": 1}, {"log": -1}, {"time_ns": 2**62}])
def test_stations_are_in_the_order_of_recordings_that_are_there(change):
    whole = make_extraction(n=3)
    first, *others = whole.observations
    damaged = replace(whole, observations=(replace(first, **change), *others))
    with pytest.raises(RecordingError, match="not in the order of their recordings and times"):
        extraction_from_npz(extraction_to_npz(damaged))


def test_thumbnails_travel_beside_it(tmp_path):
    path, extraction = tmp_path / "extraction.npz", make_hostile(make_extraction(n=3, logs=2))
    own = [Snapshot(0, k, {"left": b"large"}, bytes([255, 216, k])) for k in range(THUMBNAILS)]
    path.write_bytes(extraction_to_npz(extraction, own))
    assert_same(extraction, extraction_from_npz(path))
    assert snapshots_from_npz(path) == tuple(replace(each, jpegs={}) for each in own)
    many = [*own, Snapshot(0, THUMBNAILS, {}, b"one more"), Snapshot(0, 0, {})]
    path.write_bytes(extraction_to_npz(extraction, many[::-1]))
    assert len(snapshots_from_npz(path)) == THUMBNAILS
    path.write_bytes(extraction_to_npz(extraction))
    assert snapshots_from_npz(path) == ()


@pytest.mark.parametrize(
    "damage", [None, 3, [3], [[0, 1]], [[0, "x", ""]], [[0, 1, "?"]], [[0, 1, "A" * 99_999]]]
)
def test_damaged_thumbnails_are_left_out(tmp_path, damage):
    path = tmp_path / "extraction.npz"
    path.write_bytes(with_header(lambda header: header.update(thumbnails=damage)))
    assert not any(each.thumbnail for each in snapshots_from_npz(path))
    assert_same(make_extraction(n=2), extraction_from_npz(path))


def test_numpy_alone_can_read_it_and_the_bytes_hold_no_time():
    content = usual()
    assert content["observations.points_c"].shape == (2, 54, 3)
    assert content["wheels.0.right.time_ns"].dtype == np.int64
    header = content["header"]
    assert (header["schema_version"], header["made_by"]) == (SCHEMA_VERSION, __version__)
    assert [set(log) for log in header["logs"]] == [{"path", "sha256"}] * len(header["logs"])
    with zipfile.ZipFile(io.BytesIO(extraction_to_npz(make_extraction(n=2)))) as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda h: h.update(schema_version=99), "schema version 99"),
        (lambda h: h.pop("schema_version"), "schema version None"),
        (lambda h: h.update(format="something"), "not an extraction"),
        (lambda h: h.pop("rig"), "damaged"),
        (lambda h: h["rig"].update(extra=1), "rig.extra: Unexpected keyword argument"),
        (lambda h: h["rig"]["chain"].update(pan=3), "rig.chain.pan: must be a valid string (got 3)"),
        (lambda h: h["rig"]["cameras"].update(reference="up"), "reference 'up'"),
        (lambda h: h["rig"]["cameras"]["each"][0].update(K=[[1]]), "Camera.K: shape"),
        (lambda h: h["rig"]["chain"]["links"][0].clear(), "chain.links.0.JointLink.joint: missing"),
        (lambda h: h.update(observations=3), "out of bounds"),
        (lambda h: h.update(wheels=2), "wheels.1.right.time_ns"),
    ],
)
def test_a_changed_header_is_said(change, said):
    with pytest.raises(RecordingError) as caught:
        extraction_from_npz(with_header(change))
    assert said in caught.value.message
    assert caught.value.hint


def test_foreign_files_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="not an extraction"):
        extraction_from_npz(written({"a": np.zeros(3)}))
    for content in (b"", b"PK", b"\x89MCAP0\r\n", b"\x80\x04pickle"):
        with pytest.raises(RecordingError):
            extraction_from_npz(content)
    with pytest.raises(RecordingError, match=r"missing\.npz: cannot be read: No such file"):
        extraction_from_npz(tmp_path / "missing.npz")
    content = usual()
    for name in ("wheels.0.right.time_ns", "wheels.0.right.rad"):
        content[name] = content[name][:0]
    with pytest.raises(RecordingError, match="no readings of both wheels"):
        extraction_from_npz(written(content))
    with pytest.raises(RecordingError, match="damaged"):
        extraction_from_npz(written({"header": np.array([{"a": 1}], dtype=object)}))


def test_cut_and_flipped_files_only_raise_recording_errors():
    data = extraction_to_npz(make_extraction(n=2))
    rng = np.random.default_rng(3)
    refused = 0
    for trial in range(120):
        if trial % 3 == 0:
            damaged = data[: rng.integers(len(data))]
        else:
            changed = bytearray(data)
            changed[rng.integers(len(data))] ^= int(rng.integers(1, 256))
            damaged = bytes(changed)
        try:
            extraction_from_npz(damaged)
        except RecordingError:
            refused += 1
    assert refused > 100  # what is left are bytes of the zip's own bookkeeping that nothing reads


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        ("observations.joints", complex),
        ("observations.log", complex),
        ("observations.log", float),
        ("observations.square_m", complex),
        ("observations.left.pixels", "U20"),
        ("observations.at_rest", float),
        ("wheels.0.left.rad", complex),
        ("wheels.0.left.time_ns", float),
        ("header", complex),
    ],
)
def test_elements_of_another_type_are_refused(name, dtype):
    """Some warned that imaginary parts are discarded, others raised a TypeError after the calibration."""
    content = usual()
    header = np.frombuffer(json.dumps(content["header"]).encode(), dtype=np.uint8)
    content[name] = (content | {"header": header})[name].astype(dtype)
    with pytest.raises(RecordingError, match=rf"damaged: {name}: elements are "):
        extraction_from_npz(written(content))
