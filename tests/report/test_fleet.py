"""The table of a fleet."""

import csv
import io
import re

import numpy as np
import pytest

from mobilecal_cli.report.fleet import FleetRow, failed_text, fleet_csv, fleet_html, fleet_text
from tests.report.example import fleet_row


def test_no_sigma_is_shown_as_zero(extraction):
    rows = [fleet_row(f"r{n}", std=1e-7) for n in range(2)]
    assert "± 0.00010" in fleet_html(rows)
    assert not re.search(r"± 0\.0*[^0-9.]", fleet_html(rows))


def test_the_table_has_each_robot_s_own_rotation():
    """It was that relative to the first robot that passes, which is zero for this one, in a column "r_x_deg"."""
    rows = [fleet_row(f"r{n}", turn=(1.0, -1.2, 0.1 * n)) for n in range(2)]
    for n, line in enumerate(csv.DictReader(io.StringIO(fleet_csv(rows)))):
        told = [float(line[f"r_{axis}_deg"]) for axis in "xyz"]
        assert told == pytest.approx(np.degrees([1.0, -1.2, 0.1 * n]), abs=1e-6)
    assert "Rotations are relative to the first robot that passes" in fleet_html(rows)


def test_odometry_alone_has_multipliers_and_no_wheels():
    """The assumed radius of 0.1 m times the multiplier stood in the column of the radius, which nobody measured."""
    odometry = [fleet_row(f"o{n}", lengths=(0.1,) * 3, multipliers=(1.01, 1 + n // 5, 0.9)) for n in range(6)]
    rows = [*odometry, fleet_row("w"), FleetRow("e", "ERROR", 3, "")]
    *lines, wheels, error = csv.DictReader(io.StringIO(fleet_csv(rows)))
    assert [line["left_wheel_radius_multiplier"] for line in lines] == ["1.000000"] * 5 + ["2.000000"]
    assert {line["std_right_wheel_radius_multiplier"] for line in lines} == {"0.001000"}
    assert {line["radius_left_mm"] for line in [*lines, error]} == {""}
    assert wheels["radius_left_mm"] == "100.000000"
    assert wheels["left_wheel_radius_multiplier"] == ""
    assert lines[-1]["stands_out"] == "left_wheel_radius_multiplier"
    assert "wheel_separation_multiplier" in fleet_html(rows).replace("<wbr>", "")
    assert "multiplier" not in fleet_csv(rows[6:])


def test_the_first_five_of_what_is_skipped_are_named():
    done = [FleetRow(f"r{n}", "PASS", 0, "", skipped="already done") for n in range(6)]
    said = "Skipped, already done: 6 (r0, r1, r2, r3, r4 and 1 more)."
    assert fleet_text(done).splitlines()[-1] == said


def test_a_fleet_table_runs_no_formula_and_controls_no_terminal():
    rows = [fleet_row("=HYPERLINK(1)\x1b[31m")]
    (line,) = csv.DictReader(io.StringIO(fleet_csv(rows)))
    assert line["robot"] == "'=HYPERLINK(1)\\x1b[31m"
    assert "\x1b" not in fleet_text(rows)
    page = fleet_html([FleetRow("r", "ERROR", 3, "<script>alert(1)</script>\x1b[2J")])
    assert "<script" not in page
    assert "\x1b" not in page


def test_the_failed_robots_are_listed_by_themselves_but_judged_in_their_fleet():
    """Alone, five failed ones had other outliers than the table of all; and only they were counted as skipped."""
    lengths = [(0.1,) * 6] * 6 + [(0.2, *(0.1,) * 5)]
    levels = ["PASS", "FAIL"] * 3 + ["FAIL"]
    rows = [
        fleet_row(f"r{n}", level, lengths=metres, skipped="already done")
        for n, (level, metres) in enumerate(zip(levels, lengths, strict=True))
    ]
    *lines, skipped = fleet_text(rows).splitlines()
    assert failed_text(rows).splitlines() == [line for line in lines if "FAIL" in line]
    assert "r6  FAIL" in failed_text(rows).splitlines()[-1]
    assert "[outlier: t_x]" in failed_text(rows).splitlines()[-1]
    assert skipped.startswith("Skipped, already done: 7 ")
    assert failed_text(rows[:1]) == ""


def test_an_error_and_its_hint_are_two_sentences():
    page = fleet_html([FleetRow("r", "ERROR", 3, "no.mcap: not a recording", hint="check the path")])
    assert "no.mcap: not a recording. Hint: check the path." in page
