"""Block tridiagonal matrices of N blocks of size B, for chains of stations that are coupled to the next only."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.model import FloatArray


def chain_covariance(D: FloatArray, off: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Blocks of the inverse on and next to its diagonal, by cyclic reduction (eliminate every other station).

    Given its neighbors a and b, a station o has the mean ``x_o = K_a x_a + K_b x_b`` with
    ``K_a = -D_o^-1 off_a^T``, ``K_b = -D_o^-1 off_o``, and the covariance D_o^-1.

    Args:
        D: (N, B, B) diagonal blocks.
        off: (N, B, B), off[i] couples i (rows) to i + 1 (columns); the last is not used.

    Returns:
        (N, B, B) of each station, and (N, B, B) of each station with the next one (the last is zero).
    """
    count = len(D)
    own, cross = np.empty_like(D), np.zeros_like(D)
    if count == 1:
        own[0] = np.linalg.inv(D[0])
        return own, cross
    inverse = np.asarray(np.linalg.inv(D[1::2]), dtype=np.float64)
    odd = len(inverse)
    K_a = -inverse @ off[0 : 2 * odd : 2].mT
    K_b = -inverse @ off[1::2]
    if count % 2 == 0:
        K_b[-1] = 0.0  # the last station has no next neighbor
    kept = D[0::2].copy()
    kept[:odd] += off[0 : 2 * odd : 2] @ K_a
    after = len(kept) - 1
    kept[1:] += off[1::2].mT[:after] @ K_b[:after]
    coupled = np.zeros_like(kept)
    coupled[:after] = off[0 : 2 * after : 2] @ K_b[:after]
    own[0::2], beyond = chain_covariance(kept, coupled)

    own_a, own_b, a_b = own[0 : 2 * odd : 2], np.zeros_like(K_b), beyond[:odd]
    own_b[:after] = own[2::2]
    Kt_a, Kt_b = K_a.mT, K_b.mT
    a_o = own_a @ Kt_a + a_b @ Kt_b
    o_b = K_a @ a_b + K_b @ own_b
    cross[0 : 2 * odd : 2] = a_o
    cross[1::2] = o_b
    own[1::2] = inverse + K_a @ a_o + K_b @ o_b.mT
    return own, cross


def banded(D: FloatArray, off: FloatArray) -> FloatArray:
    """Lower band of the block tridiagonal matrix with blocks D (N, B, B) and off as in `chain_covariance`."""
    count, size, _ = D.shape
    band = np.zeros((2 * size, count, size))
    for column in range(size):
        for row in range(column, size):
            band[row - column, :, column] = D[:, row, column]
        for row in range(size):
            band[size + row - column, :, column] = off[:, column, row]
    return band.reshape(2 * size, -1)
