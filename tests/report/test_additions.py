"""A new plot, a new table and a new check: what docs/explanation/architecture.md says to write, and nothing else."""

from __future__ import annotations

import pytest

from mobilecal_cli.report import drawn, metrics, tables, verdict, wording
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.svg import Canvas
from mobilecal_cli.report.values import json_text
from mobilecal_cli.report.wording.words import Words
from tests.report.example import made, make_extraction, make_solution, page_of


@pytest.fixture
def case():
    extraction = make_extraction()
    solution = make_solution(extraction)
    drawn.draw_all(solution, extraction)  # all plots are registered
    return solution, extraction


def test_a_plot_is_one_function(case, monkeypatch):
    monkeypatch.setattr(drawn, "_PLOTS", [*drawn._PLOTS])

    @drawn.plot("coverage", "Nothing at all. Good: nothing.", each="side")
    def emptiness(solution, extraction, side):
        return Canvas(100.0, 50.0, f"emptiness of the {side} camera").svg

    page = page_of(*case)
    section = page[page.index("Coverage of the recording") :].partition("</section>")[0]
    for side in ("left", "right"):
        assert f'aria-label="emptiness of the {side} camera"' in section
    assert "Nothing at all. <strong>Good:</strong> nothing." in section


def test_a_table_is_one_function(case, monkeypatch):
    monkeypatch.setattr(tables, "_TABLES", [*tables._TABLES])

    @tables.table("motion", "Wheels", "name:wheel", "number:turns", "unit")
    def turns(case):
        return [("right", f"{len(case.extraction.observations)}.5", "")]

    report, page = made(*case), page_of(*case)
    (table,) = (each for each in report.tables if each.title == "Wheels")
    assert (table.heads, table.rows) == ((("wheel", "name"), ("turns", "number")), (("right", "12.5"),))
    assert '"title": "Wheels"' in json_text(report)
    assert '<td class="n">12.5</td>' in page


def test_a_check_is_its_numbers_and_its_sentences(case, monkeypatch):
    usual = verdict.all_checks
    monkeypatch.setitem(metrics.METRICS, "color", metrics.Metric("color", "shades"))
    check = Check("color", 3.0, 2.0, "fail")
    monkeypatch.setattr(verdict, "all_checks", lambda *given: [*usual(*given), check])
    said = Words("color of the robot", "3 shades", "under 2 shades", "The robot is too gray.", "Paint it.")
    monkeypatch.setitem(wording._WORDS, "color", lambda check: said)

    report = made(*case)
    assert (report.verdict.level, report.verdict.reason, report.verdict.checks[-1].unit) == (
        "FAIL",
        "The robot is too gray.",
        "shades",
    )
    assert "The robot is too gray." in page_of(*case)
