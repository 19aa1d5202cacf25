"""Images that contradict camera_info: one bad station, a wrong description, exchanged and mirrored images."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.errors import ObservationError
from mobilecal_cli.model.rig import Board, CameraRig
from mobilecal_cli.model.signals import Rejection, Station
from mobilecal_cli.vision import Detection, Measured, agreeing, check_arrangement, check_square
from tests.pairs import measure, with_pair
from tests.vision.scenes import random_pose, seen, stereo_rig

RIG = stereo_rig("raw")
BOARD = Board(9, 6)
SQUARE_M = 0.06
Pair = tuple[Detection, Detection]


def pairs(count: int = 8, rig: CameraRig = RIG) -> list[Pair]:
    """The board at random poses, 0.05 px of noise, as the cameras of `rig` see it."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        _, left, right = seen(rig, random_pose(rng, BOARD, SQUARE_M), BOARD, SQUARE_M)
        a, b = (Detection(pixels + rng.normal(0, 0.05, pixels.shape), 0.05) for pixels in (left, right))
        found.append((a, b))
    return found


def moved(pair: Pair, by: tuple[float, float]) -> Pair:
    return pair[0], Detection(pair[1].pixels + by, 0.05)


def measured(found: list[Pair], rig: CameraRig = RIG) -> list[Measured | Rejection]:
    stations = [Station(i, True, (), 10**9 * i, np.zeros(2), np.zeros(2)) for i in range(len(found))]
    both = zip(stations, found, strict=True)
    return [measure(station, [left], [right], rig, BOARD) for station, (left, right) in both]


def shifted(pixels: float) -> CameraRig:
    """The pair with a camera_info whose right principal point is off, along the rows of a column."""
    K = RIG.each[1].K.copy()
    K[1, 2] += pixels
    return with_pair(RIG, right=replace(RIG.each[1], K=K))


def test_a_single_bad_station_is_rejected() -> None:
    found = pairs()
    found[3] = moved(found[3], (0.0, 8.0))
    judged, notes = agreeing(measured(found))
    assert notes == ()
    assert [isinstance(one, Measured) for one in judged] == [i != 3 for i in range(8)]
    rejection = judged[3]
    assert isinstance(rejection, Rejection)
    assert rejection.reason == "left and right images inconsistent"
    assert "limit 1.5 px" in rejection.detail


def test_a_misfit_of_all_stations_is_kept_and_noted():
    found = measured(pairs(), shifted(12.0))
    assert all(one.points.rms_px > 1.5 for one in found if isinstance(one, Measured))
    judged, (note,) = agreeing(found)
    assert all(isinstance(one, Measured) for one in judged)
    assert note.startswith("camera_info does not fit the images: corners are 4.")
    check_arrangement(found, pairs(), shifted(12.0), BOARD)  # the estimate can find the cause
    found = pairs()
    found[3] = moved(found[3], (0.0, -50.0))
    judged, _ = agreeing(measured(found, shifted(12.0)))
    assert [isinstance(one, Measured) for one in judged] == [i != 3 for i in range(8)]
    judged, notes = agreeing(measured(pairs(3), shifted(12.0)))
    assert not any(isinstance(one, Measured) for one in judged)
    assert notes == ()
    check_arrangement(measured(pairs()), pairs(), RIG, BOARD)
    check_square(measured(pairs()), SQUARE_M)


WIDTH, HEIGHT = RIG.each[0].width - 1, RIG.each[0].height - 1


def mirrored(image: Detection) -> Detection:
    """Numbered right-handed again, as by the detector."""
    grid = ([WIDTH, 0] + image.pixels * [-1, 1]).reshape(BOARD.rows, BOARD.columns, 2)
    return Detection(grid[:, ::-1].reshape(-1, 2), 0.05)


def upside_down(image: Detection) -> Detection:
    return Detection([WIDTH, HEIGHT] - image.pixels, 0.05)


@pytest.mark.parametrize(
    ("mistake", "spoil"),
    [
        ("the left and the right images are exchanged", lambda left, right: (right, left)),
        ("both cameras are mirrored", lambda left, right: (mirrored(left), mirrored(right))),
        ("the right camera are mirrored", lambda left, right: (left, mirrored(right))),
        ("both cameras are upside down", lambda left, right: (upside_down(left), upside_down(right))),
    ],
)
def test_the_arrangement_of_the_images_is_named(mistake: str, spoil: Callable) -> None:
    wrong = [spoil(*pair) for pair in pairs()]
    with pytest.raises(ObservationError, match=rf"{mistake}: at [78] of 8 stations") as told:
        check_arrangement(measured(wrong), wrong, RIG, BOARD)
    assert told.value.hint


@pytest.mark.parametrize(
    "change", [lambda left, right: (right, left), lambda left, right: (left, mirrored(right))]
)
def test_what_happens_to_the_images_in_a_part_of_the_recording(change: Callable) -> None:
    """An exchange in rig.yaml would spoil the other stations."""
    wrong = [change(*pair) if number >= 3 else pair for number, pair in enumerate(pairs())]
    with pytest.raises(ObservationError, match="at 5 of 8 stations") as told:
        check_arrangement(measured(wrong), wrong, RIG, BOARD)
    assert "not so at the other stations" in told.value.hint


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        (lambda left, right: (left, left), "both image topics carry the images of the same camera"),
        (lambda left, right: (left, right[:1] * 8), "the images of the right camera do not change"),
        (lambda left, right: (left[1:], right[:-1]), "of the right camera are those of the station before"),
        (lambda left, right: (left[:-1], right[1:]), "of the left camera are those of the station before"),
    ],
)
def test_images_that_do_not_belong_together(spoil: Callable, cause: str) -> None:
    """A new calibration of the stereo pair would change nothing."""
    wrong = list(zip(*spoil(*zip(*pairs(), strict=True)), strict=True))
    with pytest.raises(ObservationError, match=cause) as told:
        check_arrangement(measured(wrong), wrong, RIG, BOARD)
    assert "calibrate" not in told.value.hint


def test_a_gross_misfit_is_named() -> None:
    rig = shifted(40.0)
    with pytest.raises(ObservationError, match="camera_info does not fit the images: at 8 of 8") as told:
        check_arrangement(measured(pairs(), rig), pairs(), rig, BOARD)
    assert "calibrate the stereo pair again" in told.value.hint


@pytest.mark.parametrize(
    ("square_m", "cure"),
    [
        (60.0, "60 looks like millimeters: set board.square_m to 0.06 (meters)"),
        (6.0, "6 looks like centimeters: set board.square_m to 0.06 (meters)"),
        (2.375, "2.375 looks like inches: set board.square_m to 0.06032 (meters)"),
        (0.08, "correct board.square_m, or calibrate the stereo pair again (camera_info)"),
    ],
)
def test_a_wrong_square_is_named(square_m: float, cure: str) -> None:
    with pytest.raises(ObservationError, match=r"the squares are 0\.06 m wide at the median of 8") as told:
        check_square(measured(pairs()), square_m)
    assert told.value.hint == cure


def test_principal_points_that_are_as_far_off_as_usual_are_no_wrong_square() -> None:
    """Their disparity makes squares far beyond a tenth too small, of a pair with a short baseline."""
    T_c_r = RIG.T_c_each[1].copy()
    T_c_r[:3, 3] *= 0.3
    near = with_pair(RIG, T_c_r=T_c_r)
    found = [moved(pair, (-0.004 * RIG.each[1].width, 0.0)) for pair in pairs(rig=near)]
    stations = measured(found, near)
    sides_m = [station.square_m for station in stations if isinstance(station, Measured)]
    assert abs(np.median(sides_m) / SQUARE_M - 1) > 0.12
    check_square(stations, SQUARE_M)
    with pytest.raises(ObservationError):
        check_square(stations, 2 * SQUARE_M)
