"""The likelihood given to Ceres (pyceres)."""

from __future__ import annotations

import pyceres

from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.state import State
from tests.bench.established_terms import Terms


class _Cost(pyceres.CostFunction):  # type: ignore[misc]
    """One term of the sum, of one station or leg."""

    def __init__(self, term, number: int, residuals: int, blocks) -> None:  # type: ignore[no-untyped-def]
        super().__init__()
        self.term, self.number = term, number
        self.set_num_residuals(residuals)
        self.set_parameter_block_sizes([len(block) for block in blocks])

    def Evaluate(self, parameters, residuals, jacobians):  # type: ignore[no-untyped-def]
        residuals[:], derivatives = self.term(jacobians is not None, self.number, *parameters)
        for block, derivative in zip(jacobians or (), derivatives, strict=True):
            if block is not None:
                block[:] = derivative.ravel()
        return True


def by_ceres(data: Dataset, start: State) -> tuple[State, float]:
    """Final state, and seconds in callbacks.

    Sparse Cholesky factors of the whole, one thread: as fast as its Schur complements here, and smaller.
    """
    terms = Terms(data, start)
    at = terms.first()
    ceres, costs = pyceres.Problem(), []

    def add(term, number, residuals, blocks):  # type: ignore[no-untyped-def]
        costs.append(_Cost(term, number, residuals, blocks))  # kept: Ceres holds no reference
        ceres.add_residual_block(costs[-1], None, blocks)

    for station, (base, error) in enumerate(zip(at.bases, at.errors, strict=True)):
        add(terms.views, station, 4 * len(data.points_k), [at.head_eye, at.board, base, error])
        add(terms.reading, station, terms.joints, [error])
    for leg, (i, j) in enumerate(data.legs):
        add(terms.leg, leg, 3, [at.bases[i], at.bases[j], at.wheels])
    ceres.set_parameter_block_constant(at.bases[0])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
    options.num_threads = 1
    options.function_tolerance, options.parameter_tolerance, options.gradient_tolerance = 1e-14, 1e-12, 1e-14
    options.minimizer_progress_to_stdout = False
    pyceres.solve(options, ceres, pyceres.SolverSummary())
    return terms.state(at), terms.seconds
