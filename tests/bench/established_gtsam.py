"""The likelihood given to gtsam."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, E

from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.state import State
from tests.bench.established_terms import Terms, Unknowns

_X, _K, _W = (gtsam.symbol(letter, 0) for letter in "xkw")  # head-eye, board, wheels


def by_gtsam(data: Dataset, start: State) -> tuple[State, float]:
    """Final state, and seconds in callbacks: Levenberg-Marquardt, stations in their order and then what they share."""
    terms = Terms(data, start)
    at = terms.first()
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for key, vector in ((_X, at.head_eye), (_K, at.board), (_W, at.wheels)):
        values.insert(key, vector)
    for station, (base, error) in enumerate(zip(at.bases, at.errors, strict=True)):
        values.insert(E(station), error)
        if station:
            values.insert(B(station), base)

    def add(term, number, residuals, keys):  # type: ignore[no-untyped-def]
        free = [place for place, key in enumerate(keys) if key != B(0)]  # the first base is known

        def whitened(this, there, jacobians):  # type: ignore[no-untyped-def]
            blocks = [at.bases[0] if key == B(0) else there.atVector(key) for key in keys]
            residual, derivatives = term(jacobians is not None, number, *blocks)
            if jacobians is not None:
                for k, place in enumerate(free):
                    jacobians[k] = derivatives[place]
            return residual

        unit = gtsam.noiseModel.Unit.Create(residuals)
        graph.add(gtsam.CustomFactor(unit, [keys[place] for place in free], whitened))

    for station in range(data.stations):
        add(terms.views, station, 4 * len(data.points_k), [_X, _K, B(station), E(station)])
        add(terms.reading, station, terms.joints, [E(station)])
    for leg, (i, j) in enumerate(data.legs):
        add(terms.leg, leg, 3, [B(i), B(j), _W])
    ordering = gtsam.Ordering()
    for station in range(data.stations):
        ordering.push_back(E(station))
        if station:
            ordering.push_back(B(station))
    for key in (_X, _K, _W):
        ordering.push_back(key)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setOrdering(ordering)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    end = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    bases = [at.bases[0], *(end.atVector(B(station)) for station in range(1, data.stations))]
    errors = [end.atVector(E(station)) for station in range(data.stations)]
    shared = (np.asarray(end.atVector(key)) for key in (_X, _K, _W))
    return terms.state(Unknowns(*shared, bases, errors)), terms.seconds
