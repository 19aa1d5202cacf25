"""Block tridiagonal matrices against dense ones."""

import numpy as np
import pytest

from mobilecal_cli.likelihood.normal import BlockTridiagonal


def chain(count, size=3):
    """A positive definite chain: D, off, and the whole matrix."""
    random = np.random.default_rng(count)
    off = random.normal(size=(count, size, size))
    root = random.normal(size=(count, size, size))
    D = root @ np.swapaxes(root, 1, 2) + 8 * np.eye(size)
    whole = np.zeros((count, size, count, size))
    for i in range(count):
        whole[i, :, i] = D[i]
        if i + 1 < count:
            whole[i, :, i + 1], whole[i + 1, :, i] = off[i], off[i].T
    return D, off, whole.reshape(count * size, -1)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 13, 100])
def test_blocks_of_the_inverse(count):
    D, off, whole = chain(count)
    own, cross = BlockTridiagonal.of(D, off).covariance()
    inverse = np.linalg.inv(whole).reshape(count, 3, count, 3)
    for i in range(count):
        assert own[i] == pytest.approx(inverse[i, :, i], abs=1e-13)
        there = inverse[i, :, i + 1] if i + 1 < count else np.zeros((3, 3))
        assert cross[i] == pytest.approx(there, abs=1e-13)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 13, 100])
def test_solutions(count):
    D, off, whole = chain(count)
    right = np.random.default_rng(1).normal(size=(count, 3, 5))
    solved = BlockTridiagonal.of(D, off).solve(right).reshape(-1, 5)
    assert solved == pytest.approx(np.linalg.solve(whole, right.reshape(-1, 5)), abs=1e-13)


def test_pairs():
    """Every recording has two stations."""
    D, off, _ = chain(9)
    off[1::2] = 0.0
    right = np.random.default_rng(1).normal(size=(9, 3, 5))
    solved, (own, cross) = BlockTridiagonal.of(D, off).solve(right), BlockTridiagonal.of(D, off).covariance()
    for i in range(0, 9, 2):
        n = min(2, 9 - i)
        here, there = BlockTridiagonal.of(D[i : i + n], off[i : i + n]), slice(i, i + n)
        assert solved[there] == pytest.approx(here.solve(right[there]), abs=1e-13)
        assert own[there] == pytest.approx(here.covariance()[0], abs=1e-13)
        assert cross[there] == pytest.approx(here.covariance()[1], abs=1e-13)


def test_not_positive_definite():
    D, off, _ = chain(6)
    off[2] *= 100.0
    with pytest.raises(np.linalg.LinAlgError):
        BlockTridiagonal.of(D, off)
