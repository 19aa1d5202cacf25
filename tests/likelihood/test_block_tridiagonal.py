"""Block tridiagonal matrices against dense ones."""

import numpy as np
import pytest

from mobilecal_cli.likelihood.normal import BlockTridiagonal


def chain(count, size=3, run=1000):
    """A positive definite chain, in runs of coupled stations: D, off, and the whole matrix."""
    random = np.random.default_rng(count)
    off = random.normal(size=(count, size, size))
    off[run - 1 :: run] = 0.0
    root = random.normal(size=(count, size, size))
    D = root @ np.swapaxes(root, 1, 2) + 8 * np.eye(size)
    whole = np.zeros((count, size, count, size))
    for i in range(count):
        whole[i, :, i] = D[i]
        if i + 1 < count:
            whole[i, :, i + 1], whole[i + 1, :, i] = off[i], off[i].T
    return D, off, whole.reshape(count * size, -1)


@pytest.mark.parametrize(
    ("count", "run"), [(1, 1000), (2, 1000), (3, 1000), (13, 1000), (100, 1000), (13, 1), (13, 2), (14, 5)]
)
def test_solutions_and_blocks_of_the_inverse(count, run):
    D, off, whole = chain(count, run=run)
    matrix, right = BlockTridiagonal.of(D, off), np.random.default_rng(1).normal(size=(count, 3, 5))
    solved = matrix.solve(right).reshape(-1, 5)
    assert solved == pytest.approx(np.linalg.solve(whole, right.reshape(-1, 5)), abs=1e-13)
    own, cross = matrix.covariance()
    inverse = np.linalg.inv(whole).reshape(count, 3, count, 3)
    for i in range(count):
        assert own[i] == pytest.approx(inverse[i, :, i], abs=1e-13)
        there = inverse[i, :, i + 1] if i + 1 < count else np.zeros((3, 3))
        assert cross[i] == pytest.approx(there, abs=1e-13)


def test_not_positive_definite():
    D, off, _ = chain(6)
    off[2] *= 100.0
    with pytest.raises(np.linalg.LinAlgError):
        BlockTridiagonal.of(D, off)
