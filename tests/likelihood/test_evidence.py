"""Evidence against stated values, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.evidence import _without_prior, equivalent_sigmas, evidence
from mobilecal_cli.likelihood.patterns import UNDERSTATED
from tests.bench import imperfect
from tests.fits import maximum_likelihood

ACROSS = np.array([[0.8, 0.6], [-0.6, 0.8]])  # an orthonormal pair of directions


def test_a_direction_that_the_data_show_counts_as_far_as_it_is_off():
    """Data of variance 0.02 that are 3 off the prior of 0 ± 1: 3 / sqrt(1 + 0.02), but for the patterns left out."""
    variance = 0.02
    posterior = variance / (1 + variance)
    off = np.array([3 * (1 - posterior)])
    chi2, dof, value, std = _without_prior(off, np.array([[posterior]]), np.ones(1))
    assert dof == 1
    assert chi2 == pytest.approx(9 / (1 + variance), rel=2 * UNDERSTATED * posterior)
    assert value == pytest.approx([3.0])
    assert std == pytest.approx([np.sqrt(variance)])


def test_a_direction_that_the_data_hardly_show_is_no_evidence():
    """Half a percent of what is known of it is from the data, and patterns of corners that are left out move it more."""
    variances, along = np.array([0.016, 0.995]), np.array([1.55, 0.34])
    chi2, dof, _, _ = _without_prior(ACROSS.T @ along, ACROSS.T @ np.diag(variances) @ ACROSS, np.ones(2))
    assert dof == 2
    assert chi2 == pytest.approx(np.sum(along**2 / (1 - variances + UNDERSTATED * variances)))
    assert equivalent_sigmas(chi2, dof) < 2


def test_a_prior_of_the_user_that_is_tighter_than_usual_is_moved_less_by_the_patterns():
    posterior = 0.98
    usual, tight = (
        _without_prior(np.array([0.5]), np.array([[posterior]]), np.array([sigma]))[0]
        for sigma in (1.0, 0.25)
    )
    assert usual == pytest.approx(0.25 / (0.02 + UNDERSTATED * posterior))
    assert tight == pytest.approx(0.25 / (0.02 + UNDERSTATED * posterior / 16))


def test_a_scale_that_squares_and_baseline_share_contradicts_neither():
    """Corners 1.5 mm off their places: "the stated squares and the stereo baseline disagree by 0.02 ± 0.08 %", as both
    would be 24 % smaller without their priors."""
    printed = replace(imperfect.AS_PRINTED, print_m=0.0015, print_across_m=0.003)
    case = imperfect.Case(motion="moving", images=80, noise=imperfect.USUAL, outside=printed).drawn()
    (found,) = (
        each for each in evidence(maximum_likelihood(case.extraction(0)).lin) if each.kind == "square_size"
    )
    assert found.sigmas < 1
    assert all(abs(each.value) < 0.005 for each in found.values.values())
