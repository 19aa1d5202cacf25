"""Block tridiagonal matrices against dense ones."""

import numpy as np
import pytest
from scipy.linalg import cholesky_banded

from mobilecal_cli.likelihood.chain import banded, chain_covariance


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
    own, cross = chain_covariance(D, off)
    inverse = np.linalg.inv(whole).reshape(count, 3, count, 3)
    for i in range(count):
        assert own[i] == pytest.approx(inverse[i, :, i], abs=1e-13)
        there = inverse[i, :, i + 1] if i + 1 < count else np.zeros((3, 3))
        assert cross[i] == pytest.approx(there, abs=1e-13)


def test_the_band_holds_the_lower_half():
    D, off, whole = chain(6)
    off[-1] = 0.0
    factor = cholesky_banded(banded(D, off), lower=True)
    L = np.linalg.cholesky(whole)
    for k in range(6):
        assert factor[k, : len(L) - k] == pytest.approx(np.diagonal(L, -k), abs=1e-13)
