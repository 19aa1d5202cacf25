"""Patterns of displaced corners and of lenses' waves."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.likelihood.patterns import UNDERSTATED, _Images, patterns
from tests.bench import imperfect


def test_the_patterns_of_the_board_are_enough_beside_the_waves_of_the_lenses():
    """Chosen without the waves, those left out moved what cameras and board have in common by five sigmas."""
    extraction = imperfect.Case(motion="moving", images=80, noise=imperfect.USUAL).extraction(0)
    data = dataset_of(extraction)
    rows = nuisance.table(extraction.rig.cameras, extraction.rig.chain)
    chosen = list(patterns(data, rows))
    waves, boards = ([row for row in chosen if row.kind == kind] for kind in ("lens_waves", "board_corners"))
    sigmas = np.tile([1.0, 1.0, 2.0], len(data.points_k))
    images = _Images.of(data, [*rows, *waves])
    H_cc, H_ce, H_ee = images.informations(*images.by_places(sigmas))
    M = np.stack([row.effect.displacement(data.points_k).ravel() / sigmas for row in boards])
    np.testing.assert_allclose(M @ M.T, np.eye(len(M)), atol=1e-9)
    B = np.linalg.solve(M @ H_ee @ M.T, M @ H_ce.T).T
    D = (H_ce - B @ M @ H_ee) @ (np.eye(len(H_ee)) - M.T @ M)
    assert eigh(D @ D.T, H_cc - B @ M @ H_ce.T, eigvals_only=True)[-1] < UNDERSTATED
