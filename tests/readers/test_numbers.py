"""How a counter starts again."""

import numpy as np
import pytest

from mobilecal_cli.readers.signals.wheels import wraps


def counter(span, step, count=400, start=None):
    return [int(v) for v in ((span // 2 if start is None else start) + step * np.arange(count)) % span]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (counter(2**16, 300), 16),
        (counter(2**16, -300), 16),
        (counter(2**8, 5), 8),
        ([v - 2**15 for v in counter(2**16, 300)], 16),  # signed
        (counter(2**32, 2**24), 32),
        (counter(4096, 30), None),
        (counter(2**16, 3), None),
        ([0] * 50, None),
        ([0, 0, 0, 500, 500, 500], None),
        ([0.5 * i for i in range(50)], None),
    ],
)
def test_how_a_counter_starts_again(values, expected):
    assert wraps(np.array(values, dtype=np.float64)) == expected
