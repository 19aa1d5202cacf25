"""The tables of the page."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from mobilecal_cli.model import Nominal, Rejection
from mobilecal_cli.report.comparison import change_from_nominal, change_since
from mobilecal_cli.rig.settings import settings_of
from tests.report.example import WHEELS, Page, made, make_solution, page_of, robot, rows_of


def shown_change(extraction, change):
    """Cells of the table of standard deviations that show a change, by parameter."""
    report = made(make_solution(extraction, "ml"), extraction, change=change)
    return {name: cells[2:] for name, cells in rows_of(report, "sigmas").items()}


def test_settings_read_as_yaml(solution, extraction):
    config = {
        "rectified": False, "board": {"square_m": None, "sizes": (1, 2.5)}, "tf": [], "file": "a/b",
        "chain": [{"xyz_m": [0.04, 0.0]}, {"joint": "pan", "axis": [0.0, 1.0]}],
    }  # fmt: skip
    text = Page(page_of(solution, extraction, config=config)).text
    for words in ("rectified false", "board.square_m null", "board.sizes [1, 2.5]", "tf []", "file a/b",
                  "chain[0].xyz_m [0.04, 0]", "chain[1].joint pan"):  # fmt: skip
        assert words in text
    assert not re.search(r"None|False|PosixPath|\{'", text)


def test_a_change_from_nominal_values_is_in_units_and_percent(extraction):
    nominal = Nominal(None, replace(WHEELS, separation_m=WHEELS.separation_m - 0.01))
    change = change_from_nominal(robot(std=1e-4), nominal)
    rows = shown_change(extraction, change)
    assert rows["separation"] == ("+10.00", "mm", f"{1000 / (1e3 * WHEELS.separation_m - 10):+.2f}")
    assert rows["t_x"] == ("–", "mm", "–")
    assert np.isnan(change.sigmas).all()


def test_a_change_between_two_calibrations_is_in_sigma(extraction):
    moved = replace(WHEELS, separation_m=WHEELS.separation_m + 0.001)
    rows = shown_change(extraction, change_since(robot(moved, 3e-4), robot(std=4e-4), "before"))
    assert rows["separation"] == ("+1.00", "mm", "+2.0")


def test_the_square_is_the_measured_one_where_none_is_stated(extraction):
    stated = settings_of(extraction)["board"]
    assert (stated["square_m"], stated["square_from"]) == (0.08, "stated")
    unstated = replace(extraction, board=replace(extraction.board, square_m=None))
    measured = settings_of(unstated)["board"]
    assert measured["square_m"] == np.median([o.square_m for o in extraction.observations])
    assert measured["square_from"] == "measured by the stereo pair"


def test_many_rejections_are_cut_and_counted(solution, extraction):
    many = tuple(Rejection("vision", "no board", f"n{i}", i) for i in range(205))
    text = Page(page_of(solution, replace(extraction, rejections=many))).text
    assert "report.json lists 5 more" in text
    assert "n199" in text
    assert "n200" not in text
