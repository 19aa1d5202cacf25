"""Several wheels a side: averaged if they turn alike, refused otherwise."""

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import Track
from mobilecal_cli.readers.signals.sides import side_of_wheels

SECONDS = np.arange(0, 60, 0.02)
TIMES_NS = (SECONDS * 1e9).astype(np.int64)
#: Drives ahead, stands, turns in place, drives back.
LEFT = np.interp(SECONDS, [0, 20, 25, 40, 60], [0, 40, 40, 20, -20])


def averaged(*wheels):
    tracks = (w if isinstance(w, Track) else Track(TIMES_NS, w) for w in wheels)
    return side_of_wheels("left", {f"left {k}": one for k, one in enumerate(tracks)})


def test_wheels_that_agree_are_averaged():
    found = averaged(LEFT + 1, 1.01 * LEFT - 1, 0.99 * LEFT)
    np.testing.assert_allclose(found.value, LEFT, atol=1e-9)
    late = Track(TIMES_NS[5:] + 7_000_000, np.interp(SECONDS[5:] + 0.007, SECONDS, LEFT))
    found = averaged(LEFT, late)
    at = found.time_ns
    np.testing.assert_allclose(found.value, np.interp(at * 1e-9, SECONDS, LEFT), atol=0.02)
    own = Track(TIMES_NS, LEFT)
    assert averaged(own) is own


BROKEN = {
    "stands still": (0 * LEFT, "do not turn alike", "wheels.left.joints"),
    "stops": (np.where(SECONDS < 30, LEFT, LEFT[1500]), "do not turn alike", "wheels.left.fields"),
    "wrong sign": (-LEFT, "turn in opposite directions", "wheels.left.signs"),
    "twice the ticks": (2 * LEFT, "do not turn alike", "find out which is wrong"),
    "slips": (LEFT + np.interp(SECONDS, [0, 5, 15], [0, 0, 20]), "do not turn alike", "wheels.left.joints"),
    "jumps": (LEFT + 50 * (SECONDS > 10) * (SECONDS % 3 < 1), "do not turn alike", "mecanum"),
}


@pytest.mark.parametrize(("broken", "said", "cure"), BROKEN.values(), ids=BROKEN)
def test_wheels_that_disagree_are_refused(broken, said, cure):
    for others in ([LEFT], [LEFT, LEFT]):
        with pytest.raises(RecordingError, match=f"left 0 and left 1 {said}") as told:
            averaged(broken, *others)
        assert cure in told.value.hint


def test_wheels_that_were_not_recorded_together():
    with pytest.raises(RecordingError, match="not recorded at the same time"):
        averaged(LEFT, Track(TIMES_NS + 10**11, LEFT))
