"""Patterns of displaced corners and of lenses' waves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.likelihood.patterns import UNDERSTATED, _informations, patterns
from mobilecal_cli.solvers import solve
from tests.bench import imperfect
from tests.extractions import Outside
from tests.judging import judge
from tests.truth import errors


@pytest.mark.parametrize("pixel_px", [0.1, 0.01])
def test_the_patterns_of_the_board_are_enough_beside_the_waves_of_the_lenses(pixel_px):
    """Chosen without the waves, those left out moved what cameras and board have in common by five sigmas.

    So did those chosen for usual images, where one camera has sharp ones: wheels of the robot on a PASS by 0.9 %.
    """
    noise = replace(imperfect.USUAL, pixel_px=pixel_px)
    extraction = imperfect.Case("camera on the base", motion="moving", images=80, noise=noise).extraction(0)
    data = dataset_of(extraction)
    rows = table(extraction.rig.cameras, extraction.rig.chain)
    chosen = list(patterns(data, rows))
    waves, boards = ([row for row in chosen if row.kind == kind] for kind in ("lens_waves", "board_corners"))
    sigmas = np.tile([1.0, 1.0, 2.0], len(data.points_k))
    usual = replace(data, whitening=0.1 / data.claimed_px * data.whitening, claimed_px=0.1)
    H_cc, H_ce, H_ee = _informations(usual, [*rows, *waves], sigmas)
    M = np.stack([row.effect.displacement(data.points_k).ravel() / sigmas for row in boards])
    np.testing.assert_allclose(M @ M.T, np.eye(len(M)), atol=1e-9)
    B = np.linalg.solve(M @ H_ee @ M.T, M @ H_ce.T).T
    D = (H_ce - B @ M @ H_ee) @ (np.eye(len(H_ee)) - M.T @ M)
    assert eigh(D @ D.T, H_cc - B @ M @ H_ce.T, eigvals_only=True)[-1] < UNDERSTATED


def test_short_waves_fade_where_images_become_less_sharp():
    """They once began at a limit, where results moved by 0.3 sigmas; all waves together are as large as ever."""
    data = dataset_of(imperfect.Case("camera on the base").extraction(0))
    all_px, short = (0.02, 0.025, 0.0275, 0.02999, 0.03, 0.1), slice(28, None)
    amplitudes = []
    for px in all_px:
        waves = [row for row in patterns(replace(data, claimed_px=px), ()) if row.kind == "lens_waves"]
        along = np.array([row.effect.along[4:] for row in waves])
        assert not np.any(along - np.diag(np.diag(along)))
        amplitudes.append(np.diag(along))
    np.testing.assert_allclose([np.sum(of**2) for of in amplitudes], np.sum(amplitudes[0] ** 2))
    largest = [float(of[short].max(initial=0.0) / of[0]) for of in amplitudes]
    assert largest == pytest.approx([1, 1, 0.5, 0.002, 0, 0])
    assert [len(of) for of in amplitudes] == [54, 54, 54, 54, 28, 28]


@pytest.mark.parametrize(
    ("motion", "seed"), [("moving", 2), pytest.param("standard", 3, marks=pytest.mark.long)]
)
def test_waves_of_a_lens_do_no_harm_to_sharp_images_of_one_camera(motion, seed):
    """Of patterns chosen for what all stations share, those left out moved single poses: two FAIL, two by 5 sigmas."""
    waves = Outside(lens_px=0.15, lens_waves_px=(320.0, 1280.0))
    case = imperfect.Case("camera on pan-tilt", 24 if motion == "standard" else 20, motion)
    case = replace(case.drawn(noise=replace(imperfect.USUAL, pixel_px=0.03)), outside=waves)
    extraction = case.extraction(seed)
    solution = solve(extraction)
    true = imperfect.true_robot(imperfect.ROBOTS[case.robot], extraction, case.route(seed))
    assert judge(solution, extraction).level == "PASS"
    assert np.nanmax(np.abs(errors(solution.parameters, true) / solution.uncertainty.std)) < 3
