"""Several wheels a side: averaged, unless one of them does not turn as the others do."""

import re

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.signals import Track
from mobilecal_cli.readers.signals.sides import sides_of

SECONDS = np.arange(0, 60, 0.02)
TIMES_NS = (SECONDS * 1e9).astype(np.int64)
#: Drives ahead, stands, turns in place, drives back.
PHASES = [0, 20, 25, 40, 60]
RIGHT = np.interp(SECONDS, PHASES, [0, 40, 40, 60, 20])
LEFT = np.interp(SECONDS, PHASES, [0, 40, 40, 20, -20])


def track(value, times_ns=TIMES_NS):
    return Track(times_ns, value)


def averaged(left, right=(RIGHT, RIGHT)):
    notes = []
    sides = {"left": left, "right": right}
    tracks = {
        side: [v if isinstance(v, Track) else track(v) for v in values] for side, values in sides.items()
    }
    wheels = {side: [(f"{side} {k}", one) for k, one in enumerate(each)] for side, each in tracks.items()}
    return sides_of(wheels, notes), notes


def test_wheels_that_agree_are_averaged():
    found, notes = averaged([LEFT + 1, 1.01 * LEFT - 1, 0.99 * LEFT])
    np.testing.assert_allclose(found["left"].value, LEFT, atol=1e-9)
    assert notes == []
    late = track(np.interp(SECONDS[5:] + 0.007, SECONDS, LEFT), TIMES_NS[5:] + 7_000_000)
    found, notes = averaged([LEFT, late])
    at = found["left"].time_ns
    np.testing.assert_allclose(found["left"].value, np.interp(at * 1e-9, SECONDS, LEFT), atol=0.02)
    assert notes == []
    own = track(LEFT)
    found, notes = averaged([own], [RIGHT])
    assert found["left"] is own
    assert notes == []


def test_wheels_of_other_sizes_are_averaged_and_noted():
    """One of 4.5 % less counted as a tire like the others, without a word."""
    found, notes = averaged([LEFT, 0.955 * LEFT])
    np.testing.assert_allclose(found["left"].value, 0.9775 * LEFT, atol=1e-9)
    (note,) = notes
    assert note.startswith("left 1 turns by 95.5 rad and left 0 by 100.0 rad, 4.7 % more")


BROKEN = {
    "stands still": 0 * LEFT,
    "stops": np.where(SECONDS < 30, LEFT, LEFT[1500]),
    "wrong sign": -LEFT,
    "twice the ticks": 2 * LEFT,
    "slips": LEFT + np.interp(SECONDS, [0, 5, 15], [0, 0, 20]),
    "jumps": LEFT + 50 * (SECONDS > 10) * (SECONDS % 3 < 1),
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN)
def test_one_of_three_is_left_out(broken):
    found, notes = averaged([LEFT, broken, LEFT])
    np.testing.assert_allclose(found["left"].value, LEFT, atol=1e-9)
    assert len(notes) == 1
    assert notes[0].startswith("left 1: left out")


@pytest.mark.parametrize("which", ["stands still", "stops"])
def test_one_of_two_that_stands_still_is_left_out(which):
    found, notes = averaged([BROKEN[which], LEFT])
    np.testing.assert_allclose(found["left"].value, LEFT, atol=1e-9)
    assert "left 0: left out, it stands still in" in notes[0]


@pytest.mark.parametrize("apart", [-12 * (SECONDS > 10.3), np.interp(SECONDS, [10, 11], [0, 12])])
def test_a_wheel_that_differs_once_is_averaged(apart):
    """A driver that starts again, and a slip: the recording was refused. Of three wheels, that one is left out."""
    found, notes = averaged([LEFT, LEFT + apart])
    np.testing.assert_allclose(found["left"].value, LEFT + apart / 2, atol=1e-9)
    assert len(notes) == 1
    assert re.match("left 0 and left 1 differ by more than 10 % in [12] of 5. seconds with motion", notes[0])
    found, notes = averaged([LEFT, LEFT + apart, LEFT])
    np.testing.assert_allclose(found["left"].value, LEFT, atol=1e-9)


@pytest.mark.parametrize(
    ("which", "said", "cure"),
    [
        ("wrong sign", "turn in opposite directions", "wheels.left.signs"),
        ("twice the ticks", "do not turn alike", "find out which is wrong"),
        ("slips", "do not turn alike", "wheels.left.joints"),
        ("jumps", "do not turn alike", "mecanum"),
    ],
)
def test_two_that_disagree_are_refused(which, said, cure):
    with pytest.raises(RecordingError, match=f"left 0 and left 1 {said}") as told:
        averaged([LEFT, BROKEN[which]])
    assert cure in told.value.hint
