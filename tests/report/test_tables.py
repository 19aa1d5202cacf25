"""The tables of the page."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.report.comparison import change_from_nominal, change_since
from mobilecal_cli.report.formats import Table
from mobilecal_cli.rig.settings import settings_of
from tests.report.example import WHEELS, Page, made, make_solution, page_of, robot, rows_of


def shown_change(extraction, change):
    """Cells of the table of standard deviations that show a change, by parameter."""
    report = made(make_solution(extraction, "ml"), extraction, change=change)
    return rows_of(report, "limits", "Change")


def test_a_change_from_nominal_values_is_in_units_and_percent(extraction):
    nominal = Nominal(None, replace(WHEELS, separation_m=WHEELS.separation_m - 0.01))
    change = change_from_nominal(robot(std=1e-4), nominal)
    rows = shown_change(extraction, change)
    change_m, unit, percent = rows["separation"]
    assert float(change_m) == pytest.approx(0.01, abs=1e-4)
    assert (unit, percent) == ("m", f"{1000 / (1e3 * WHEELS.separation_m - 10):+.2f}")
    assert "t_x" not in rows


def test_a_change_between_two_calibrations_is_in_sigma(extraction):
    moved = replace(WHEELS, separation_m=WHEELS.separation_m + 0.001)
    rows = shown_change(extraction, change_since(robot(moved, 3e-4), robot(std=4e-4), "before"))
    change_m, unit, sigmas = rows["separation"]
    assert float(change_m) == pytest.approx(0.001, abs=1e-4)
    assert (unit, sigmas) == ("m", "+2.0")


def test_the_square_is_the_measured_one_where_none_is_stated(extraction):
    stated = settings_of(extraction)["board"]
    assert (stated["square_m"], stated["square_from"]) == (0.08, "stated")
    unstated = replace(extraction, board=replace(extraction.board, square_m=None))
    measured = settings_of(unstated)["board"]
    assert measured["square_m"] == np.median([o.square_m for o in extraction.observations])
    assert measured["square_from"] == "measured by the stereo pair"


def test_many_rejections_are_cut_and_counted(solution, extraction):
    many = tuple(Rejection("vision", "no board", f"n{i}", i) for i in range(105))
    text = Page(page_of(solution, replace(extraction, rejections=many))).text
    assert "report.json lists 5 more" in text
    assert "n99" in text
    assert "n100" not in text


def test_decimal_points_are_aligned_on_the_terminal():
    rows = [("height", "-1.5", "± 0.25"), ("radius", "0.1234", "± 0.0012"), ("turns", "12", "")]
    lines = Table.of(("", "strong:value", "number:1 sigma"), rows).lines()
    assert {line.index(".") for line in lines[1:3]} == {lines[3].index("12") + 2}
    assert {line.index("±") for line in lines[1:3]} == {lines[1].index("±")}
