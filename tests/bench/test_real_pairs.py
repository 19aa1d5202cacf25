"""Real stereo pairs with a wrong camera_info: the estimated cameras see the board better."""

import pytest

from mobilecal_cli.solvers.findings import contradictions_of
from tests.bench.real_pairs import FIGURES, by_opencv, cases, compared, estimated, figures, pairs_in
from tests.vision.scenes import bouguet

MEAN, SPREAD, REPROJECTION = 0, 1, len(FIGURES) - 1
FOCAL, POINT, MIXED = (
    "focal length of the left, +0.5 %",
    "principal point of the left, x, +5 px",
    "focal lengths, principal point x, k1 of the left, turn about x, y, z, baseline",
)


@pytest.fixture(scope="module")
def opencv(shared_data):
    return pairs_in(shared_data / "stereo" / "opencv_samples")


@pytest.fixture(scope="module")
def mrpt(shared_data):
    return pairs_in(shared_data / "stereo" / "mrpt_stereo_calib")


@pytest.fixture(scope="module")
def published(opencv):
    """Where these pairs differ from the published calibration: estimates with nothing wrong."""
    pairs, (width, _) = opencv
    case = cases(width)["nothing"]
    return compared(case.of(bouguet()), pairs, others=False).found


@pytest.mark.long
@pytest.mark.parametrize("name", ["nothing", FOCAL, POINT])
def test_one_wrong_constant(opencv, published, name):
    pairs, (width, _) = opencv
    true = bouguet()
    case = cases(width)[name]
    result = compared(case.of(true), pairs, others=False)
    assert not result.refused
    assert result.left_out == 0
    assert abs(result.after[MEAN]) < 0.03  # what each image is shifted by itself stays
    assert result.after[SPREAD] < result.before[SPREAD]
    assert result.after[REPROJECTION] < result.before[REPROJECTION]
    for constant, expected in case.expected(true).items():
        value, std = result.found[constant]
        own, own_std = published[constant]
        assert abs(own) < 3 * own_std
        assert abs(value - own - expected) < 1.5 * std  # waves of the lens look a little like a focal length


def test_a_wrong_cause_is_named(opencv):
    """Four times as wrong, the left camera's distortion is what the pairs contradict, and nothing else."""
    pairs, (width, _) = opencv
    case = cases(width)["k1 of the left, +0.02"].times(4)
    result = compared(case.of(bouguet()), pairs, others=False)
    assert result.named == (("distortion", "left camera"),)


def test_other_pictures(mrpt):
    pairs, size = mrpt
    true = by_opencv(pairs, size, jointly=True)
    case = cases(size[0])[MIXED]
    result = compared(case.of(true), pairs, others=False)
    best = figures([true] * len(pairs), pairs)
    assert result.before[SPREAD] > 3 * best[SPREAD]
    assert result.after[SPREAD] < 1.2 * best[SPREAD]  # 1.18: without the waves that the estimate has, too
    assert {kind for kind, _ in result.named} <= set(case.right)


@pytest.mark.long
def test_a_board_that_a_first_fit_leaves_out_is_used_without_legs(mrpt):
    """No legs between stations could say whether the board is wrong."""
    pairs, size = mrpt
    case = cases(size[0])["k1 of the left, +0.02"].times(4)
    fit = estimated(case.of(by_opencv(pairs, size, jointly=True)), pairs)
    assert fit.inliers.views.all()
    assert [(e.kind, e.part) for e in contradictions_of(fit)] == [("distortion", "left camera")]
