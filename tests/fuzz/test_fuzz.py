"""Mutated inputs: only documented errors, no hang, no memory beyond the bound."""

import os
import signal

import pytest

from mobilecal_cli.errors import MobilecalError, RecordingError
from tests.fuzz.hunt import hunt
from tests.fuzz.targets import Target, place, targets


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return targets(tmp_path_factory.mktemp("sound"))


def checked(sound, count: int, first: int) -> None:
    haul = hunt(sound, count, first)
    assert haul.findings == []
    assert sum(haul.outcomes.values()) == count
    kinds = {outcome for _, outcome in haul.outcomes}
    assert kinds >= {"read", "RecordingError", "ConfigError"}


def test_a_hundred_and_fifty(sound):
    checked(sound, 150, 0)


@pytest.mark.slow
def test_a_hundred_thousand(sound):
    checked(sound, 100_000, 1_000_000)


def blunder(path):
    if path.stat().st_size % 3 == 0:
        raise KeyError("a bug")
    if path.stat().st_size % 3 == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    raise RecordingError("as it should be", "")


def test_the_hunt_sees_bugs_and_crashes():
    """A product with an undocumented error and a crash: both are found, and the hunt goes on."""
    planted = {"planted": Target({"x": bytes(300)}, "x", blunder)}
    haul = hunt(planted, 16)
    assert sum(haul.outcomes.values()) == 16
    assert haul.outcomes["planted", "RecordingError"] > 0
    assert haul.outcomes["planted", "FOUND KeyError"] > 0
    assert haul.outcomes["", "FOUND hang or crash"] > 0
    assert len(haul.findings) == 16 - haul.outcomes["planted", "RecordingError"]


def test_every_sound_input_is_read(sound, tmp_path):
    """What is refused before any damage would never be hunted through."""
    refused = {}
    for name, target in sound.items():
        try:
            target.use(place(target, target.files, tmp_path / "input"))
        except MobilecalError as error:
            refused[name] = error.message
    assert refused == {}
