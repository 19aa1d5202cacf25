"""A new plot, a new table and a new check: what docs/explanation/architecture.md says to write, and nothing else."""

import pytest

from mobilecal_cli.report import criteria, plots, tables, verdict
from mobilecal_cli.report.formats import Table, json_text
from mobilecal_cli.report.junit import junit_xml
from mobilecal_cli.report.page import CONTENTS
from mobilecal_cli.report.svg import Canvas
from tests.report.example import made, page_of


@pytest.fixture
def case(solution, extraction):
    return solution, extraction


def test_a_plot_is_one_function(case, monkeypatch):
    monkeypatch.setattr(plots, "_PLOTS", [*plots._PLOTS])

    @plots.plot("stations")
    def emptiness(solution, extraction):
        for side in extraction.rig.cameras.names:
            yield plots.Drawn(Canvas(100.0, 50.0, f"emptiness of the {side} camera").svg, "Nothing at all.")

    page = page_of(*case)
    section = page[page.index('id="stations"') :].partition("</details>")[0]
    for side in ("left", "right"):
        assert f'aria-label="emptiness of the {side} camera"' in section
    assert "<figcaption>Nothing at all.</figcaption>" in section


def test_a_table_is_one_function(case, monkeypatch):
    monkeypatch.setattr(tables, "_TABLES", [*tables._TABLES])

    @tables.table
    def turns(case):
        rows = [("right", f"{len(case.extraction.observations)}.5", "")]
        yield Table.of(("name:wheel", "number:turns", "unit"), rows, "record", "Wheels")

    report, page = made(*case), page_of(*case)
    (table,) = (each for each in report.tables if each.title == "Wheels")
    assert (table.heads, table.rows) == ((("wheel", "name"), ("turns", "number")), (("right", "12.5"),))
    assert '"title": "Wheels"' in json_text(report)
    assert '<td class="n">12.5</td>' in page


def test_each_section_that_is_named_is_one_of_the_page(case):
    named = {metric.section for each in criteria.CRITERIA for metric in each.metrics}
    named |= {section for section, _, _ in plots._PLOTS} | {table.section for table in made(*case).tables}
    assert named <= {*CONTENTS, ""}


def test_a_criterion_is_one_function(case, monkeypatch):
    monkeypatch.setattr(criteria, "CRITERIA", [*criteria.CRITERIA])
    monkeypatch.setattr(verdict, "CRITERIA", criteria.CRITERIA)

    @criteria.criterion(criteria.Metric("color", "shades", section="limits"))
    def color(case, metric):
        shades = len(case.extraction.observations) / 4
        why = "The robot is too gray."
        yield metric.check(shades, 2.0, "color of the robot", "Paint it.", why=why)

    report = made(*case)
    (check,) = (check for check in report.verdict.checks if check.id == "color")
    assert (report.verdict.level, report.verdict.reason) == ("FAIL", "The robot is too gray.")
    assert (check.value, check.unit, check.measured_text) == (3.0, "shades", "3 shades")
    assert report.metrics["color"] == 3.0
    assert verdict.gates_of(["color=4"], {}) == {"color": 4.0}
    page = page_of(*case)
    assert "The robot is too gray." in page
    assert '<details class="part" id="limits" open>' in page
    assert 'name="color of the robot"' in junit_xml("log", report.verdict).decode()
    assert '"measured_text": "3 shades"' in json_text(report)
