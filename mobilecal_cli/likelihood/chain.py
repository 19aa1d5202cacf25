"""Block tridiagonal matrices of N blocks of size B, for chains of stations that are coupled to the next only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mobilecal_cli.model import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """A positive definite chain, solved by cyclic reduction: every other station is eliminated, again and again.

    Given its neighbors a and b, a station o has the mean ``x_o = D_o^-1 r_o + K_a x_a + K_b x_b`` with
    ``K_a = -D_o^-1 off_a^T``, ``K_b = -D_o^-1 off_o``, and the covariance D_o^-1.

    Attributes:
        inverse: (N/2, B, B) D_o^-1 of every second station; of all stations, where none is coupled to the next.
        K_a, K_b: (N/2, B, B) each; K_b of the last one is zero where it has no next neighbor.
        kept: the chain of the other stations; None where none is coupled.
    """

    inverse: FloatArray
    K_a: FloatArray
    K_b: FloatArray
    kept: Chain | None

    @classmethod
    def of(cls, D: FloatArray, off: FloatArray) -> Self:
        """The chain with some blocks.

        Args:
            D: (N, B, B) diagonal blocks.
            off: (N, B, B), off[i] couples i (rows) to i + 1 (columns); the last is not used.

        Raises:
            LinAlgError: not positive definite.
        """
        count, alone = len(D), not off[:-1].any()
        out = D if alone else D[1::2]
        np.linalg.cholesky(out)
        inverse = np.asarray(np.linalg.inv(out), dtype=np.float64)
        if alone:
            return cls(inverse, off[:0], off[:0], None)
        odd = len(inverse)
        K_a, K_b = -inverse @ off[0 : 2 * odd : 2].mT, -inverse @ off[1::2]
        if count % 2 == 0:
            K_b[-1] = 0.0
        kept = D[0::2].copy()
        kept[:odd] += off[0 : 2 * odd : 2] @ K_a
        after = len(kept) - 1
        kept[1:] += off[1::2].mT[:after] @ K_b[:after]
        coupled = np.zeros_like(kept)
        coupled[:after] = off[0 : 2 * after : 2] @ K_b[:after]
        return cls(inverse, K_a, K_b, cls.of(kept, coupled))

    def solve(self, right: FloatArray) -> FloatArray:
        """(N, B, R) right sides → (N, B, R)."""
        if self.kept is None:
            return np.asarray(self.inverse @ right)
        odd, after = len(self.K_a), len(right) - len(self.K_a) - 1
        out = right[1::2]
        reduced = right[0::2].copy()
        reduced[:odd] += self.K_a.mT @ out
        reduced[1:] += self.K_b[:after].mT @ out[:after]
        x = np.empty_like(right)
        x[0::2] = others = self.kept.solve(reduced)
        x[1::2] = self.inverse @ out + self.K_a @ others[:odd]
        x[1 : 2 * after : 2] += self.K_b[:after] @ others[1:]
        return x

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Blocks of the inverse on and next to its diagonal.

        Returns:
            (N, B, B) of each station, and (N, B, B) of each station with the next one (the last is zero).
        """
        if self.kept is None:
            return self.inverse, np.zeros_like(self.inverse)
        others, beyond = self.kept.covariance()
        odd, after = len(self.K_a), len(others) - 1
        own = np.empty((odd + len(others), *others.shape[1:]))
        cross = np.zeros_like(own)
        own[0::2] = others
        own_a, own_b, a_b = others[:odd], np.zeros_like(self.K_b), beyond[:odd]
        own_b[:after] = others[1:]
        a_o = own_a @ self.K_a.mT + a_b @ self.K_b.mT
        o_b = self.K_a @ a_b + self.K_b @ own_b
        cross[0 : 2 * odd : 2] = a_o
        cross[1::2] = o_b[: len(cross[1::2])]
        own[1::2] = self.inverse + self.K_a @ a_o + self.K_b @ o_b.mT
        return own, cross
