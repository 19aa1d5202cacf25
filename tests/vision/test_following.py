"""Tracking of the board: it follows motion, stops at occlusion, and is never off by one square."""

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision import BoardFollower, Detection, Miss, detect
from mobilecal_cli.vision.detection import find_board, least_response, may_show_board
from mobilecal_cli.vision.following import follow
from mobilecal_cli.vision.values import Appearance, rms
from tests.vision.scenes import detected, missed, opencv_pixels, pose, render, stereo_rig

BOARD = Board(9, 6, 0.05)
CAMERA = stereo_rig("raw").each[0]
STEP_NS = 50_000_000


def pose_at(time_s: float) -> np.ndarray:
    """A board that moves to the right by about 10 px per image, accelerates and rotates."""
    x_m, turn = -0.15 + 0.3 * time_s + 0.2 * time_s**2, (0.2, -0.2 + 0.3 * time_s, 0.1)
    return pose(x_m, 0.02, 1.0, turn, BOARD, 0.05)


def frame(time_s: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    T = pose_at(time_s)
    image = render(CAMERA, T, BOARD, 0.05, noise=2.0, blur_px=0.7, seed=seed)
    return image, opencv_pixels(CAMERA, se3.act(T, 0.05 * BOARD.grid()))


@pytest.fixture(scope="module")
def film() -> list[tuple[np.ndarray, np.ndarray]]:
    return [frame(0.05 * i, seed=i) for i in range(10)]


@pytest.fixture(scope="module")
def first(film) -> tuple[np.ndarray, np.ndarray, Appearance]:
    """The first image, its corners, and how the board looks in it."""
    image, truth = film[0]
    appearance = detected(detect(image, 9, 6)).appearance
    assert appearance is not None
    return image, truth, appearance


def counted_searches(monkeypatch) -> list[int]:
    searches: list[int] = []

    def counted(*args, **kwargs):
        searches.append(1)
        return find_board(*args, **kwargs)

    monkeypatch.setattr("mobilecal_cli.vision.following.find_board", counted)
    return searches


def test_a_moving_board_is_followed_as_well_as_it_is_found(film, monkeypatch):
    follower = BoardFollower(BOARD, thorough=True)
    searches = counted_searches(monkeypatch)
    followed, found = [], []
    for i, (image, truth) in enumerate(film):
        followed.append(detected(follower.find(image, i * STEP_NS)).pixels - truth)
        found.append(detected(detect(image, 9, 6)).pixels - truth)
    assert len(searches) == 1
    assert rms(np.array(followed)) < 0.02
    assert rms(np.array(followed)) < 1.1 * rms(np.array(found))


def test_a_board_that_stops_is_followed_by_optical_flow(film, monkeypatch):
    """The extrapolation is 20 px off, as far as the board moved before."""
    follower = BoardFollower(BOARD, thorough=False)
    searches = counted_searches(monkeypatch)
    for k, (image, truth) in enumerate((film[0], film[1], film[3], film[3])):
        assert rms(detected(follower.find(image, k * STEP_NS)).pixels - truth) < 0.02
    assert len(searches) == 1


def test_the_claimed_covariances_are_the_errors(film):
    follower = BoardFollower(BOARD, thorough=True)
    squares = []
    for i, (image, truth) in enumerate(film):
        seen = detected(follower.find(image, i * STEP_NS))
        off = seen.pixels - truth
        squares += list(np.einsum("mi,mij,mj->m", off, np.linalg.inv(seen.cov), off) / 2)
    # 1 if the model were all: rendered pixels hold their light to a sixteenth of an edge's share.
    assert 0.7 < np.mean(squares) < 1.8


@pytest.mark.parametrize(
    "shift", [(1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 2), (-1, 0), (0, -2), (-1, -1)]
)
def test_a_grid_some_squares_beside_is_let_go(first, shift):
    image, truth, appearance = first
    grid = truth.reshape(6, 9, 2)
    right, down = grid[2, 5] - grid[2, 4], grid[3, 4] - grid[2, 4]
    assert isinstance(follow(image, truth + 0.5, appearance, BOARD), Detection)
    assert isinstance(follow(image, truth + shift[0] * right + shift[1] * down, appearance, BOARD), Miss)


@pytest.mark.parametrize("blur_px", [1.2, 1.8])
@pytest.mark.parametrize("way", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_board_that_moves_by_a_square_along_a_diagonal_is_no_square_off(way, blur_px):
    """The colors are right there, and the outermost corners, at the border of the pattern, have half of the contrast.

    A station with such corners in both cameras looked like a moved board, in five of 69 images of a fast robot.
    """
    board = Board(8, 5, 0.05)
    follower = BoardFollower(board, thorough=False)
    for time_ns, moved in ((0, 0.0), (1_000_000_000, 0.95 * 0.05)):
        T = pose(moved * way[0], moved * way[1], 1.0, (0.0, 0.0, 0.0), board, 0.05)
        image = render(CAMERA, T, board, 0.05, noise=1.5, blur_px=blur_px)
        truth = opencv_pixels(CAMERA, se3.act(T, 0.05 * board.grid()))
        assert rms(detected(follower.find(image, time_ns)).pixels - truth) < 0.2


def test_a_hidden_board_is_lost_and_found_again(film):
    follower = BoardFollower(BOARD, thorough=False)
    assert isinstance(follower.find(film[0][0], 0), Detection)
    wall = np.clip(np.full((480, 640), 110.0) + np.random.default_rng(3).normal(0, 2, (480, 640)), 0, 255)
    for i in range(1, 4):
        assert isinstance(follower.find(wall.astype(np.uint8), i * STEP_NS), Miss)
    again = detected(follower.find(film[4][0], 4 * STEP_NS))
    assert rms(again.pixels - film[4][1]) < 0.02
    follower = BoardFollower(BOARD, thorough=False)
    assert isinstance(follower.find(film[0][0], 0), Detection)
    covered = film[1][0].copy()
    middle = int(film[1][1][:, 0].mean())
    covered[:, middle:] = 110
    assert isinstance(follower.find(covered, STEP_NS), Miss)


def test_searches_in_vain_are_rare(film, monkeypatch):
    follower, searches = BoardFollower(BOARD, thorough=False), counted_searches(monkeypatch)
    random = np.random.default_rng(4)
    for i in range(20):
        rough = np.clip(110 + random.normal(0, 12, (480, 640)), 0, 255).astype(np.uint8)
        assert isinstance(follower.find(rough, 100_000_000 * i), Miss)
    assert len(searches) == 5  # at 0, 0.4, 0.8, 1.2 and 1.6 s
    assert isinstance(follower.find(film[4][0], 2_000_000_000), Detection)
    assert len(searches) == 6


def test_images_without_saddle_points_are_not_searched(film, monkeypatch):
    follower = BoardFollower(BOARD, thorough=True)
    follower.find(film[0][0], 0)
    monkeypatch.setattr("mobilecal_cli.vision.following.find_board", lambda *_: pytest.fail("searched"))
    smooth = np.full((480, 640), 110, np.uint8)
    missed(follower.find(smooth, STEP_NS))


def test_saddle_points_of_a_board_are_stronger_than_those_of_noise(film):
    noise = np.random.default_rng(4).normal(110, 4, (480, 640))
    least = min(least_response(image, 54) for image, _ in film)  # a tenth of a corner's
    assert all(may_show_board(image, 54, least) for image, _ in film)
    assert not may_show_board(np.clip(noise, 0, 255).astype(np.uint8), 54, least)
    assert least_response(np.full((480, 640), 90, np.uint8), 54) == 0.0


def test_a_board_that_leaves_the_picture_is_said_to(first):
    image, truth, appearance = first
    gone = missed(follow(image, truth - [truth[:, 0].min(), 0.0], appearance, BOARD))
    assert gone.reason == "board partly occluded or outside the image"


@pytest.mark.parametrize("corner", [0, 8, 45, 53, 4, 22])
def test_a_corner_predicted_wrongly_is_found_by_the_others(first, corner):
    """An outermost corner draws the smooth grid to itself; it was once kept 7 px off."""
    image, truth, appearance = first
    for off in ([7.0, 0.0], [-6.0, 4.0], [0.0, -8.0], [10.0, 10.0]):
        expected = truth.copy()
        expected[corner] += off
        found = detected(follow(image, expected, appearance, BOARD))
        assert np.abs(found.pixels - truth).max() < 0.1, off


def test_a_corner_behind_a_finger_is_refused_when_found_and_when_tracked(first):
    image, truth, appearance = first
    for corner in (0, 45, 22):
        hidden = image.copy()
        u, v = np.rint(truth[corner]).astype(int)
        hidden[v - 9 : v + 10, u - 9 : u + 10] = 120
        assert isinstance(detect(hidden, 9, 6), Miss), corner
        assert isinstance(follow(hidden, truth, appearance, BOARD), Miss), corner


def test_a_board_that_is_found_again_is_tracked_back_through_the_images_that_were_not_searched(film):
    covered = film[0][0].copy()
    covered[:, int(film[0][1][:, 0].mean()) :] = 110
    follower = BoardFollower(BOARD, thorough=False)
    missed(follower.find(covered, 0))
    for i in range(1, 7):
        missed(follower.find(film[i][0], i * STEP_NS))
        assert not follower.earlier
    detected(follower.find(film[7][0], 7 * STEP_NS))
    assert sorted(follower.earlier) == [i * STEP_NS for i in range(1, 7)]
    for i in range(1, 7):
        assert rms(follower.earlier[i * STEP_NS].pixels - film[i][1]) < 0.02
    detected(follower.find(film[8][0], 8 * STEP_NS))
    assert not follower.earlier


def test_tracking_back_ends_where_the_board_comes_into_view(film):
    wall = np.clip(np.random.default_rng(3).normal(110, 12, (480, 640)), 0, 255).astype(np.uint8)
    follower = BoardFollower(BOARD, thorough=False)
    for i in range(5):
        missed(follower.find(wall, i * STEP_NS))
    missed(follower.find(film[5][0], 5 * STEP_NS))
    missed(follower.find(film[6][0], 6 * STEP_NS))
    detected(follower.find(film[7][0], 7 * STEP_NS))
    assert sorted(follower.earlier) == [5 * STEP_NS, 6 * STEP_NS]
