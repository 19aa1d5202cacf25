"""Other places than the page: notebook, job summary, JUnit, JSON of suggestions."""

import json
import re
import shutil
import xml.etree.ElementTree as ET

import pytest

from mobilecal_cli.calibrate import steps
from mobilecal_cli.calibrate.steps import Data, Fit
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.report.text import job_summary
from mobilecal_cli.rig.config import UNCONFIGURED
from tests.command import succeeded
from tests.conftest import REPOSITORY
from tests.report.example import HOSTILE, Page, drawn, made, make_extraction, make_solution, report_on

NOTEBOOK = REPOSITORY / "docs" / "tutorial" / "notebook.ipynb"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """A directory with a calibration of an extraction, which needs no images."""
    folder = tmp_path_factory.mktemp("summary")
    (folder / "robot.npz").write_bytes(extraction_to_npz(make_extraction()))
    succeeded("calibrate", "robot.npz", "-o", "result", "-q", cwd=folder)
    return folder


def test_every_cell_of_the_notebook_runs(sample_logs, tmp_path, monkeypatch):
    """Each cell as a notebook runs it: the value of its last expression is shown."""
    (tmp_path / "sample_logs").mkdir()
    shutil.copy(sample_logs / "paper_robot.mcap", tmp_path / "sample_logs")
    monkeypatch.chdir(tmp_path)
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    names, shown = {}, []
    for cell in cells:
        *lines, last = "".join(cell["source"]).splitlines()
        try:
            code = compile(last, "<cell>", "eval")
        except SyntaxError:
            code = compile("None", "<cell>", "eval")
            lines.append(last)
        exec(compile("\n".join(lines), "<cell>", "exec"), names)
        shown.append(eval(code, names))
    assert "PASS" in Page(shown[0]._repr_html_()).text
    assert len(shown[1]) == len(names["report"].values.numbers)
    assert "your limits" in shown[2].verdict.reason
    assert (tmp_path / "result" / "report.html").is_file()
    assert "outputs" in cells[0]
    assert not any(cell["outputs"] for cell in cells)


def test_a_notebook_shows_verdict_numbers_and_one_picture():
    extraction = make_extraction()
    report = report_on(make_solution(extraction, "ml"), extraction)
    card = report._repr_html_()
    page = Page(f"<main>{card}</main>")
    assert page.text.startswith(report.verdict.level)
    assert card.count("<img") == 1
    assert len(card) < 40_000
    assert "<script" not in card
    assert "<style" not in card


def test_the_job_summary_takes_hostile_strings():
    extraction = make_extraction()
    report = made(make_solution(extraction, "ml"), extraction, logs=(LogSource(HOSTILE, HOSTILE),))
    text = job_summary(report)
    assert "\\<script\\>" in text
    assert len(text.split("\n| ")) == 3 + len(report.numbers)
    assert all(character == "\n" or character.isprintable() for character in text)


def test_the_summary_has_the_change_and_is_appended(result):
    accepted = result / "result" / "params.yaml"
    path = result / "summary.md"
    path.write_text("before\n")
    succeeded(
        "calibrate", "result/extraction.npz", "-o", "again", "-q", "--last", accepted, "--summary", path,
        "--junit", "junit.xml", cwd=result,
    )  # fmt: skip
    text = path.read_text()
    assert text.startswith("before\n### PASS: ")
    assert "Difference from" in text
    assert len(re.findall(r"\| [+-][\d.]+ \| (?:m|rad) \| [+-]0\.0 \|", text)) == 9
    suite = ET.parse(result / "junit.xml").getroot()
    assert 0 < float(suite.get("time")) < 600


def test_suggest_as_json(result):
    done = succeeded("suggest", "result/extraction.npz", "-q", "--json", cwd=result)
    advice = json.loads(done.out)
    assert advice["limiting"].endswith("of its variance.")
    assert min(stop["gain"] for stop in advice["stops"]) >= 0.05
    assert all(" improves from " in cure for cure in advice["cures"])


def test_suggestions_go_by_the_user_s_limits(monkeypatch):
    solution, extraction = drawn()
    for name, limit in (("along_mm_per_m", "distance"), ("heading_deg_per_turn", "heading")):
        config = UNCONFIGURED.model_copy(update={"gates": {f"predicted.{name}": 0.01}})
        monkeypatch.setattr(steps, "load", lambda *_: Data(extraction))
        monkeypatch.setattr(steps, "fitted", lambda *_, **__: Fit(solution, extraction, "ml"))
        assert re.search(f"limits? the {limit} by dead reckoning", steps.suggest([], config).limiting)
