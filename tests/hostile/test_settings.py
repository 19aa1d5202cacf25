"""Configurations and URDFs that somebody made to do harm."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mobilecal_cli.errors import ConfigError, MobilecalError, RecordingError
from mobilecal_cli.export.extraction import LARGEST_BYTES, extraction_from_npz, extraction_to_npz
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.rig.config import load_rig, parse_settings, read_urdf
from tests.hostile.test_recordings import LAUGHS, MEMORY_BYTES, bounded
from tests.report.example import make_extraction

YAMLS = {
    "tag": ("board: !!python/object/apply:os.system ['touch pwned']", "not valid YAML"),
    "laughs": (LAUGHS, "anchors that expand to more"),
    "laughs in a value": (LAUGHS + "board: *a59\n", "anchors that expand to more"),
    "itself": ("board: &a {columns: *a}", "contains itself"),
    "itself in a list": ("board: &a [*a]", "contains itself"),
    "deep": ("board: " + "[" * 1000, "nested deeper"),
    "deep items": ("board:\n  " + "- " * 1000, "nested deeper"),
    "deep keys": ("board:\n  " + "? " * 1000, "nested deeper"),
    "deep lines": ("\n".join(" " * i + "a:" for i in range(400)), "not valid YAML"),
    "deep and closed": ("board: " + "[" * 300 + "]" * 300, "nested deeper"),
    "long": ("board:\n" + "  x: 1\n" * 100_000, "larger than 131072 bytes"),
    "number": ("board: {columns: " + "9" * 100_000 + "}", "not valid YAML"),
    "many keys": ("\n".join(f"k{i}: 1" for i in range(2000)), "unknown key"),
}


@pytest.mark.parametrize("name", YAMLS)
def test_rig_yaml(tmp_path, name):
    content, said = YAMLS[name]
    path = tmp_path / "rig.yaml"
    path.write_text(content)
    with bounded(), pytest.raises(ConfigError, match=said) as caught:
        load_rig(path, {})
    assert len(caught.value.message) < 200_000
    assert not Path("pwned").exists()


@pytest.mark.parametrize("value", ["!!python/name:os.system", "&a [*a]", "[" * 1000])
def test_a_setting_on_the_command_line(value):
    with bounded(), pytest.raises(ConfigError):
        parse_settings([f"board={value}"])


def test_a_configuration_that_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    for path in (Path("/dev/zero"), tmp_path / "pipe.yaml", tmp_path):
        with bounded(), pytest.raises(ConfigError, match=r"not a (regular file|rig\.yaml|URDF)"):
            load_rig(path, {})
        (tmp_path / "rig.yaml").write_text(f"head: {{urdf: {path}}}")
        with bounded(), pytest.raises(ConfigError, match=r"not a (regular file|rig\.yaml|URDF)"):
            read_urdf(load_rig(tmp_path / "rig.yaml", {}))


ENTITIES = "<!ENTITY a0 'lol'>" + "".join(f"<!ENTITY a{i} '&a{i - 1};&a{i - 1};'>" for i in range(1, 60))
URDFS = {
    "laughs": f"<!DOCTYPE robot [{ENTITIES}]><robot name='&a59;'/>",
    "external": "<!DOCTYPE robot [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot name='&x;'/>",
    "external type": "<!DOCTYPE robot SYSTEM 'http://example.com/x.dtd'><robot name='x'/>",
    "deep": "<robot name='x'>" + "<a>" * 200_000,
    "deep and closed": "<robot name='x'>" + "<a>" * 20_000 + "</a>" * 20_000 + "</robot>",
    "ring": "<robot name='x'><link name='a'/><link name='b'/>"
    "<joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint>"
    "<joint name='k' type='fixed'><parent link='b'/><child link='a'/></joint></robot>",
}


@pytest.mark.parametrize("name", URDFS)
def test_urdf(name):
    with bounded():
        try:
            urdf = parse_urdf(URDFS[name])
        except MobilecalError as error:
            assert error.hint  # noqa: PT017
            return
        # What may be parsed holds nothing of a file, and leads nowhere without end.
        assert "root:" not in urdf.name
        with pytest.raises(ConfigError):
            urdf.path("base", "a")
        if "a" in urdf.links:
            assert len(urdf.path("a", "b")) == 1


def members_of(npz: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(npz)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


POINTS = "observations.points_c.npy"


@pytest.fixture(scope="module")
def members():
    return members_of(extraction_to_npz(make_extraction(n=4)))


def test_an_extraction_whose_zeros_fill_the_memory(tmp_path, members, monkeypatch):
    """With a smaller limit, for the sake of the test's time; the limit itself is half of what a test may ask for."""
    assert LARGEST_BYTES <= MEMORY_BYTES / 2
    monkeypatch.setattr("mobilecal_cli.export.extraction.LARGEST_BYTES", 2**24)
    path = zipped(tmp_path / "extraction.npz", members | {POINTS: bytes(2**25)})
    assert path.stat().st_size < 2**17
    with bounded(), pytest.raises(RecordingError, match=r"unpack to \d+ bytes \(limit"):
        extraction_from_npz(path)


def test_an_extraction_whose_array_claims_petabytes(tmp_path, members):
    shape = members[POINTS].index(b"(") + 1
    huge = members[POINTS][:shape] + b"9" + members[POINTS][shape:]
    path = zipped(tmp_path / "extraction.npz", members | {POINTS: huge.replace(b"(9", b"(999999999", 1)})
    with bounded(), pytest.raises(RecordingError, match="damaged"):
        extraction_from_npz(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_an_extraction_of_absurd_numbers(tmp_path, members, value):
    absurd = members[POINTS][:-8] + np.float64(value).tobytes()
    path = zipped(tmp_path / "extraction.npz", members | {POINTS: absurd})
    with bounded(), pytest.raises(RecordingError, match="not finite, or above"):
        extraction_from_npz(path)
