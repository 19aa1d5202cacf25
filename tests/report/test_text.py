"""The texts for the terminal, and the prose of the page."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.findings import EstimatedConstant
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.report.comparison import Comparison, comparison_text
from mobilecal_cli.report.evaluation import Evaluated, evaluation_text
from mobilecal_cli.report.fleet import fleet_text
from mobilecal_cli.report.text import summary_text
from mobilecal_cli.report.verdict import Verdict
from mobilecal_cli.solvers import evaluate
from tests.extractions import slipped
from tests.golden import assert_golden
from tests.report.example import (
    ROBOT,
    WHEELS,
    Page,
    fleet_row,
    hostile_solution,
    made,
    make_hostile,
    make_snapshots,
    make_solution,
    page_of,
    robot,
)


@pytest.fixture(scope="module")
def texts(extraction):
    """Every text of a calibration by the default method; a wheel slips once."""
    slipping = slipped(extraction, 5, 0.2)
    solution = make_solution(slipping, "ml")
    trial = evaluate(extraction, solution.parameters, ROBOT.wheels)
    report = made(solution, slipping, trial)
    few = Verdict("PASS", "", "", report.verdict.checks[:2])
    past = [replace(robot(std=1e-4), created=f"2015-06-0{day}") for day in (1, 2, 3)]
    past[1] = replace(past[1], wheels=WheelGeometry(0.083, 0.082, 0.35), logs=(LogSource("b", "1"),))
    rows = [
        fleet_row(f"robot-{n}", level, code, "the reason")
        for n, (level, code) in enumerate((("PASS", 0), ("FAIL", 6), ("NOT ENOUGH", 6)))
    ]
    page = page_of(solution, slipping, make_snapshots(slipping), trial=trial)
    return {
        "details": summary_text(report, verbose=True),
        "evaluation": evaluation_text(Evaluated(trial, extraction, few, ())),
        "comparison": comparison_text(Comparison(("one", "two", "three"), tuple(past))),
        "fleet": fleet_text(rows),
        "page": prose(page),
    }


def prose(page):
    """The text of a page, one line an element, without tables, plots and images."""
    bare = re.sub(r"<(style|script|svg|table)\b.*?</\1>", "", page, flags=re.DOTALL)
    marked = re.sub(r"</(p|h\d|li|td|th|dt|dd|option|button|summary|div)>", "\n", bare)
    lines = (" ".join(unescape(re.sub(r"<[^>]*>", "", line)).split()) for line in marked.split("\n"))
    return "\n".join(line for line in lines if line) + "\n"


def test_each_text_against_its_golden_copy(texts):
    for name, text in texts.items():
        assert_golden(text, name)


def test_the_table_shows_clock_offsets_and_two_digits_of_each_sigma(extraction):
    solved = make_solution(extraction, "ml")
    moving = replace(
        solved,
        constants={
            name: EstimatedConstant(name, "clock", "joints", "clock offset", value, std, 0.2)
            for name, value, std in (("time_joints", 0.00321, 5e-5), ("time_wheels", -0.0012, 2e-7))
        },
    )
    table = summary_text(made(moving, extraction), verbose=True)
    assert re.search("time_joints +clock offset +[+]3.210 +0.050 +200 +ms", table)
    assert re.search("time_wheels +clock offset +-1.20000 +0.00020 +200 +ms", table)
    assert "clock" not in summary_text(made(solved, extraction))


def test_what_is_noted_of_the_recording_is_on_the_terminal(extraction):
    """A cable that was pulled half-way left a PASS of half the stations without a word."""
    notes = tuple(f"{k} images are not used: no readings around them\x1b[2J" for k in (21, 22, 23, 24))
    noted = replace(extraction, notes=notes)
    solution = make_solution(extraction, "ml")
    report = made(solution, noted)
    short, everything = (summary_text(report, verbose) for verbose in (False, True))
    assert set(short.splitlines()) - set(everything.splitlines()) == {"Note: 1 more, see Input in the report"}
    assert [line for line in short.splitlines() if line.startswith("Note")] == [
        *(f"Note: {k} images are not used: no readings around them\\x1b[2J" for k in (21, 22, 23)),
        "Note: 1 more, see Input in the report",
    ]
    assert "Note: 24 images" in everything
    plain = replace(extraction, notes=())
    assert "Note" not in summary_text(made(solution, plain))


def test_the_terminal_has_at_most_twenty_lines(extraction):
    solution = make_solution(extraction, "ml")
    report = made(solution, extraction)
    assert len(summary_text(report).splitlines()) + 1 + len(report.verdict.lines) + 1 <= 20


def test_the_table_cannot_steer_the_terminal(solution, extraction):
    hostile = make_hostile(extraction)
    table = summary_text(made(hostile_solution(solution, hostile), hostile))
    assert all(character == "\n" or character.isprintable() for character in table)


def test_gimbal_lock_is_said(extraction, solution):
    locked = Parameters(se3.transform(se3.from_rpy(np.radians([-164, 89.4, -166])), np.zeros(3)), WHEELS)
    solution = replace(solution, parameters=locked)
    assert "0.6° from gimbal lock" in Page(page_of(solution, extraction)).text
    table = summary_text(made(solution, extraction), verbose=True)
    assert "the orientation is 0.6° from gimbal lock" in " ".join(table.split())
