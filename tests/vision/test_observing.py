"""Stations: real pairs against Bouguet's calibration, and every inconsistency of stereo pairs."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate.detect import snapshot_jpeg
from mobilecal_cli.model.observations import Observation
from mobilecal_cli.model.rig import Board, Markers
from mobilecal_cli.model.signals import Rejection, Shot, Station
from mobilecal_cli.vision import Detection, Measured, Miss, agreeing, detect, resolve_square
from mobilecal_cli.vision.grid import turned
from tests.pairs import measure
from tests.vision.scenes import bouguet, pose, render, seen, stereo_rig

BOARD = Board(9, 6)
SQUARE_M = 0.06
RIG = stereo_rig("raw")
HIDDEN = Miss("board partly occluded or outside the image", "7 x 6 seen")
T_C_K = pose(0.05, 0.02, 1.2, (0.3, -0.2, 0.1), BOARD, SQUARE_M)


def station(pairs: int = 1) -> Station:
    pairs = tuple(Shot((1000 + i, 1000 + i)) for i in range(pairs))
    return Station(3, True, pairs, 1000, np.array([0.1, -0.2]), np.zeros(2))


def pairs(
    count: int, sigma_px: float, board: Board = BOARD, T_c_k: np.ndarray = T_C_K
) -> tuple[list[Detection | Miss], list[Detection | Miss]]:
    rng = np.random.default_rng(0)
    _, left, right = seen(RIG, T_c_k, board, SQUARE_M)
    return tuple(
        [Detection(p + sigma_px * rng.standard_normal(p.shape), sigma_px) for _ in range(count)]
        for p in (left, right)
    )


def observe(*seen: object) -> Observation | Rejection:
    """Observation or rejection from the arguments of `measure` and a square's side, m."""
    *pictures, square_m = seen
    (result,), _ = agreeing([measure(*pictures)])
    return resolve_square(result, square_m, 2) if isinstance(result, Measured) else result


def observed(result: Observation | Rejection) -> Observation:
    assert isinstance(result, Observation), result
    return result


def rejected(result: Observation | Rejection) -> Rejection:
    assert isinstance(result, Rejection)
    assert (result.stage, result.time_ns, result.station) == ("vision", 1000, 3)
    return result


@pytest.mark.parametrize("square_m", [None, SQUARE_M])
def test_exact_corners(square_m: float | None) -> None:
    found = observed(observe(station(), *pairs(1, 0.0), RIG, BOARD, square_m))
    np.testing.assert_allclose(found.T_c_k, T_C_K, atol=1e-9)
    assert found.square_m == pytest.approx(SQUARE_M, rel=1e-9)
    assert found.reprojection_px < 1e-8
    assert (found.log, found.station, found.time_ns, found.at_rest) == (2, 3, 1000, True)
    np.testing.assert_array_equal(found.joints, [0.1, -0.2])


def test_noise_averages_and_is_measured() -> None:
    found = observed(observe(station(16), *pairs(16, 0.2), RIG, BOARD, SQUARE_M))
    truth = seen(RIG, T_C_K, BOARD, SQUARE_M)
    for corners, expected in ((found.views[0], truth[1]), (found.views[1], truth[2])):
        assert corners.pictures == 16
        assert corners.sigma_px == pytest.approx(0.05, rel=0.2)
        assert np.sqrt(np.mean((corners.pixels - expected) ** 2)) == pytest.approx(0.05, rel=0.2)
    delta = se3.log(found.T_c_k @ se3.inverse(T_C_K))
    assert delta @ np.linalg.solve(found.T_c_k_cov, delta) < 25  # chi-squared with 6 degrees of freedom


def test_errors_common_to_all_shots_are_no_smaller_for_averaging() -> None:
    left, right = pairs(1, 0.2)
    found = observed(observe(station(9), left * 9, right * 9, RIG, BOARD, SQUARE_M))
    assert found.views[0].sigma_px == pytest.approx(0.2, rel=0.3)


def test_shots_missing_in_one_picture_and_one_that_moved_are_left_out():
    left, right = pairs(4, 0.1)
    left[1] = Miss("blurred", "borders are 0.8 squares wide")
    found = observed(observe(station(4), left, right, RIG, BOARD, SQUARE_M))
    assert found.views[0].pictures == found.views[1].pictures == 3
    left, right = pairs(5, 0.05)
    left[4] = Detection(left[4].pixels + 2.0, 0.05)
    found = observed(observe(station(5), left, right, RIG, BOARD, SQUARE_M))
    assert found.views[0].pictures == 4


def test_no_pair() -> None:
    hidden, none = HIDDEN, Miss("no board found", "none")
    both = [hidden, none, hidden], [none, none, hidden]
    result = rejected(observe(station(3), *both, RIG, BOARD, 0.06))
    assert result.reason == "board partly occluded or outside the image"
    assert result.detail == (
        "3 stereo pairs; left: 2 x board partly occluded or outside the image (7 x 6 seen); 1 x no board found (none); "
        "right: 2 x no board found (none); 1 x board partly occluded or outside the image (7 x 6 seen)"
    )


@pytest.mark.parametrize("hidden", [HIDDEN, None], ids=["not found", "no image"])
@pytest.mark.parametrize("stated", [SQUARE_M, None])
@pytest.mark.parametrize("k", [0, 1])
def test_one_camera_of_a_pair(k: int, stated: float | None, hidden: Miss | None) -> None:
    """The camera that sees the board counts alone, with squares as stated or as other stations measure them."""
    found = list(pairs(4, 0.1))
    found[1 - k] = [hidden] * 4
    measured = measure(station(4), *found, RIG, Board(9, 6, stated))
    assert isinstance(measured, Measured)
    assert measured.points is None
    o = observed(resolve_square(measured, SQUARE_M))
    assert [view.seen.all() for view in o.views] == [k == 0, k == 1]
    assert not o.several
    assert o.square_m == SQUARE_M
    delta = se3.log(o.T_c_k @ se3.inverse(T_C_K))
    assert delta @ np.linalg.solve(o.T_c_k_cov, delta) < 25  # chi-squared with 6 degrees of freedom
    if stated is None:
        assert rejected(resolve_square(measured, None)).reason == "size of the squares unknown"


@pytest.mark.parametrize("turn_deg", [85, 89.9, 95])
def test_corners_beside_the_other_camera_have_no_absurd_pixels(turn_deg: float) -> None:
    """The polynomial of its distortion grows without limit; such an extraction was refused as damaged."""
    turned = se3.transform(se3.from_rpy(np.radians([0.0, turn_deg, 0.0])), np.zeros(3))
    left, right = RIG.each
    right = replace(right, distortion="plumb_bob", D=np.array([-0.3, 0.1, 0, 0, -0.02]))
    rig = replace(RIG, each=(left, right), T_c_each=(np.eye(4), turned), calibrated=False)
    found, _ = pairs(4, 0.1)
    o = observed(observe(station(4), found, [HIDDEN] * 4, rig, Board(9, 6, SQUARE_M), SQUARE_M))
    assert not o.views[1].seen.any()
    assert np.abs(o.views[1].pixels).max() < 1e4
    np.testing.assert_array_less(np.abs(o.views[0].pixels), 1e4)


@pytest.mark.parametrize("second", [range(27, 54), range(24, 54)])
def test_images_that_show_different_parts_of_the_board(second: range) -> None:
    """Too few corners are in most images: the camera does not count."""
    board = replace(BOARD, markers=Markers("charuco", "DICT_5X5_50", 0.75))
    _, *both = seen(RIG, T_C_K, board, SQUARE_M)

    def part(pixels: np.ndarray, shown: range) -> Detection:
        return Detection(pixels, 0.1, np.isin(np.arange(54), shown))

    left, right = ([part(pixels, range(27)), part(pixels, second)] for pixels in both)
    result = rejected(observe(station(2), left, right, RIG, board, SQUARE_M))
    assert result.detail == f"{27 - second.start} of 54 corners visible in an image, minimum 8"
    whole = [part(both[0], range(54))] * 2
    found = observed(observe(station(2), whole, right, RIG, board, SQUARE_M))
    assert [view.seen.all() for view in found.views] == [True, False]
    assert not found.views[1].seen.any()


def test_a_rest_that_is_none() -> None:
    left, right = pairs(6, 0.05)
    drifting = [Detection(d.pixels + 3.0 * i, 0.05) for i, d in enumerate(left)]
    result = rejected(observe(station(6), drifting, right, RIG, BOARD, SQUARE_M))
    assert result.reason == "board or robot moved during the stop"
    assert "drift by 7.5" in result.detail


def test_other_boards_and_squares_are_rejected():
    other = pose(0.05, 0.1, 1.2, (0.3, -0.2, 0.1), BOARD, SQUARE_M)
    (left, _), (_, right) = pairs(1, 0.05), pairs(1, 0.05, T_c_k=other)
    result = rejected(observe(station(), left, right, RIG, BOARD, SQUARE_M))
    assert result.reason == "left and right images inconsistent"
    assert "px" in result.detail
    result = rejected(observe(station(), *pairs(1, 0.05), RIG, BOARD, 0.08))
    assert result.reason == "unexpected square size"
    assert result.detail == "triangulated squares are 60.0 mm wide, expected 80.0 mm"


@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (7, 7), (8, 8)])
def test_numbering_of_left_right_and_shots_is_brought_together(columns: int, rows: int) -> None:
    board = Board(columns, rows)
    T_c_k = pose(0.05, 0.02, 1.2, (0.3, -0.2, 0.1), board, SQUARE_M)
    left, right = pairs(3, 0.02, board, T_c_k)
    right = [Detection(turned(d.pixels, Board(columns, rows), 2), 0.02) for d in right]
    left[2] = Detection(turned(left[2].pixels, Board(columns, rows), 2), 0.02)
    found = observed(observe(station(3), left, right, RIG, board, SQUARE_M))
    np.testing.assert_allclose(found.T_c_k, T_c_k, atol=2e-3)
    assert found.reprojection_px < 0.1


def test_snapshot() -> None:
    image = render(RIG.each[0], T_C_K, BOARD, SQUARE_M)
    decoded = cv2.imdecode(np.frombuffer(snapshot_jpeg(image[:, 5:]), np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded.shape == (480, 635)
    assert np.abs(decoded.astype(int) - image[:, 5:]).mean() < 2


def test_real_pairs_show_squares_of_30_mm(shared_data: Path) -> None:
    sides_mm = []
    for i in range(1, 8):
        paths = (shared_data / f"stereo/opencv_samples/{side}0{i}.jpg" for side in ("left", "right"))
        left, right = (detect(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), 9, 6) for path in paths)
        found = observed(observe(station(), [left], [right], bouguet(), BOARD, None))
        assert found.square_m == pytest.approx(0.030, abs=0.05e-3)
        assert found.reprojection_px < 0.2
        grid = 1e3 * found.points_c.reshape(6, 9, 3)
        sides_mm += [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    side_mm = np.concatenate(sides_mm)
    assert abs(side_mm.mean() - 30) < 0.03
    assert side_mm.std() < 0.19
