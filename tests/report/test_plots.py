"""Plots, and images with marks."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.model.observations import Snapshot
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.model.solution import Outlier
from mobilecal_cli.report.plots import budget_bar, corner_residuals, leg_views, thumbnails, trail
from mobilecal_cli.report.use import FIGURES, Error
from tests.pairs import with_views
from tests.report.example import WHEELS, Page, make_extraction, make_snapshots, make_solution, page_of


def test_overlays_draw_both_marks_for_every_corner(extraction, page):
    circles = [a for tag, a in page.tags if tag == "circle" and "class" not in a]
    images = sum(tag == "image" and a["width"] != "96" for tag, a in page.tags)
    assert len(circles) == images * 2 * extraction.board.corners
    assert (
        7 <= images <= 2 * len(extraction.observations) - 1
    )  # three legs, and the worst on the first screen


def test_overlays_show_the_largest_errors_first(extraction, solution):
    views = leg_views(solution, extraction, make_snapshots(extraction))
    px = solution.residuals.leg_reprojection_px
    assert 3 <= len({view.observation for view in views}) == len(views) <= len(px)
    largest = [f"{error:.2f} px" for error in sorted(px, reverse=True)]
    assert [view.title.partition(": ")[2] for view in views] == largest[: len(views)]
    worst = int(np.argmax(px))
    np.testing.assert_allclose(
        np.array(views[0].pictures[1].marks)[:, 2:],
        solution.residuals.predicted_px[1, worst] + 0.5,
        atol=0.006,
    )


def test_overlays_use_the_legs_that_have_pictures(extraction, solution):
    first = make_snapshots(extraction)[:1]
    (view,) = leg_views(solution, extraction, first)
    assert view.title.startswith("Leg 0–1: ")
    assert leg_views(solution, extraction, ()) == []


def test_small_pictures_of_all_stations_say_why_one_is_not_used(extraction, solution):
    snapshots = make_snapshots(extraction)
    missed = replace(snapshots[0], station=90, jpegs={})
    of_nothing = replace(snapshots[0], station=91, jpegs={})
    extraction = replace(extraction, rejections=(Rejection("vision", "board blurred", "", 5, 90),))
    solution = replace(
        solution, outliers=(Outlier("station", 0, (2,), 5, ""), Outlier("slip", 0, (4, 5), 5, ""))
    )
    shown = thumbnails(solution, extraction, (*snapshots, missed, of_nothing))
    assert [each.station for each in shown[:-1]] == [str(o.station) for o in extraction.observations]
    assert [each.observation for each in shown] == [*range(len(extraction.observations)), -1]
    assert {each.station: each.reason for each in shown if each.reason} == {
        "2": "outlier",
        "90": "board blurred",
    }


def test_a_broken_picture_is_said(solution, extraction):
    broken = (Snapshot(0, 0, {"left": b"not a jpeg", "right": b""}),)
    assert "cannot be decoded" in Page(page_of(solution, extraction, broken)).text


def test_several_logs_have_a_path_each():
    extraction = make_extraction(n=5, logs=2)
    page = Page(page_of(make_solution(extraction), extraction))
    assert "robot_1.mcap" in page.text
    labels = [attributes.get("aria-label") for _, attributes in page.tags]
    assert labels.count("top view of the base path with cameras and board") == 2
    assert "2:0–2:1" in page.text


def test_the_trail_runs_through_the_stations(solution, extraction):
    path = trail(extraction, 0, WHEELS)
    ends = solution.residuals.T_w_v[:, :2, 3]
    assert np.linalg.norm(path[-1] - ends[-1]) < 0.03
    nearest = np.linalg.norm(path[None] - ends[:, None], axis=-1).min(axis=1)
    assert np.all(nearest < 0.03)


def test_a_long_recording_stays_small(solution, extraction):
    """Of 360 stations, with fewer outlines and corners than there are."""
    long = replace(extraction, observations=30 * extraction.observations)
    assert sum(len(drawn.svg) for drawn in corner_residuals(solution, long)) < 450_000


@pytest.mark.parametrize("blind", [[3], range(12)])
def test_a_camera_without_corners(extraction, blind):
    """The plots of its corners raised AttributeError and IndexError, and so did its images."""
    seen, none = list(extraction.observations), np.zeros(extraction.board.corners, dtype=bool)
    for i in blind:
        seen[i] = with_views(seen[i], right=replace(seen[i].views[1], seen=none))
    half = replace(extraction, observations=tuple(seen))
    solution, pictures = make_solution(half), make_snapshots(extraction)
    assert "corner residuals across the image of the left camera" in page_of(solution, half, pictures)
    for view in leg_views(solution, half, pictures):
        marks = [len(overlay.marks) for overlay in view.pictures]
        assert marks == [54, 0 if view.observation in blind else 54]


def test_the_bar_of_what_limits_is_full():
    shares = (
        (0.6, "pixel_px"),
        (0.25, "joint_rad"),
        (0.03, "floor_rad"),
        (0.07, "wheel_share"),
        (0.05, "board"),
    )
    drawn = budget_bar(Error(FIGURES[0], 72.0, 5.0, shares))
    assert [re.findall(rf"{name} (\d+) %", drawn.svg)[0] for name in ("corners", "wheels", "other")] == [
        "60",
        "7",
        "8",
    ]
    assert drawn.title == "What limits the camera position (72 mm, limit 5)"
