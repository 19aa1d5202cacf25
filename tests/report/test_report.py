"""The page, the JSON and the table, from made-up answers."""

from __future__ import annotations

import base64
import csv
import dataclasses
import hashlib
import io
import json
import math
import re
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.comparison import difference, history
from mobilecal_cli.model import (
    CalibratedRobot,
    EstimatedConstant,
    FleetRow,
    HeadChain,
    JointLink,
    Knowledge,
    LogSource,
    Nominal,
    Parameters,
    Rejection,
    Snapshot,
    WheelGeometry,
)
from mobilecal_cli.model.text import visible
from mobilecal_cli.pipeline.settings import settings_of
from mobilecal_cli.report.comparison import change_from_nominal, change_since, comparison_text
from mobilecal_cli.report.evaluation import evaluation_data, evaluation_text
from mobilecal_cli.report.findings import suggestion_sentences
from mobilecal_cli.report.fleet import fleet_csv, fleet_html, fleet_text
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.junit import junit_xml
from mobilecal_cli.report.numbers import image_coverage, value_text
from mobilecal_cli.report.overlays import leg_views
from mobilecal_cli.report.page import TERMS, link_terms
from mobilecal_cli.report.plots import trail
from mobilecal_cli.report.text import summary_text
from mobilecal_cli.solvers import evaluate
from tests.golden import assert_golden
from tests.report.example import (
    HOSTILE,
    ROBOT,
    WHEELS,
    made,
    make_extraction,
    make_hostile,
    make_snapshots,
    make_solution,
    page_of,
    rows_of,
)
from tests.report.schema import validated

ROBOT_PARAMETERS = Parameters(ROBOT.T_h_c, ROBOT.wheels)
VOID = {"meta", "br", "link", "img"}


class Page(HTMLParser):
    """Checks that every element closes in order, and gathers what the tests ask for."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        assert len(attrs) == len(dict(attrs)), f"<{tag}> has an attribute twice"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script", "title"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def extraction():
    return make_extraction()


@pytest.fixture(scope="module")
def solution(extraction):
    return make_solution(extraction)


@pytest.fixture(scope="module")
def html(solution, extraction):
    return page_of(solution, extraction, make_snapshots(extraction))


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_the_page_says_what_matters_first(page, solution):
    text = page.text
    assert text.index("PASS") < text.index("The nine parameters") < text.index("Checks")
    for words in (
        "rotation vector",
        f"{1e3 * solution.parameters.wheels.radius_right_m:.2f}",
        f"{1e3 * solution.parameters.wheels.separation_m:.2f}",
        f"{1e3 * solution.linear.point_rms_m:.2f}",
        f"{1e3 * solution.point_rms_m:.2f}",
        "board partly hidden",
        "head_link",
    ):
        assert words in text


def test_the_page_needs_no_network_and_runs_its_own_script_only(html, page):
    for tag, attributes in page.tags:
        assert tag not in {"iframe", "link", "object", "embed", "img", "form"}
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href"):
            assert re.match(r"#|data:image/jpeg;base64,", attributes.get(name) or "#")
    assert [attributes for tag, attributes in page.tags if tag == "script"] == [
        {"type": "application/json", "id": "data"},
        {},
    ]
    (policy,) = (a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert "unsafe" not in policy
    for tag, directive in (("script", "script-src"), ("style", "style-src")):
        text = html.rpartition(f"<{tag}>")[2].partition(f"</{tag}>")[0]
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{directive} 'sha256-{digest}'" in policy
    assert "@import" not in html
    assert not re.search(r"url\((?!#)", html)


def test_ids_are_unique_and_references_resolve(html, page):
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    used = re.findall(r'(?:href="#|url\(#)([^")]+)', html)
    assert used
    assert set(used) <= set(ids)


def test_figures_follow_the_page_colours(html):
    assert "var(--ink)" in html
    assert not re.search(r"#0[1-6]0[1-6]0[1-6]\b", html)


def test_the_page_is_small_and_repeats_byte_for_byte(solution, extraction, html):
    assert len(html.encode()) < 1_000_000
    assert page_of(solution, extraction, make_snapshots(extraction)) == html


def test_overlays_draw_both_marks_for_every_corner(extraction, page):
    circles = [a for tag, a in page.tags if tag == "circle" and "class" not in a]
    legs = len(extraction.observations) - 1
    assert len(circles) == legs * 2 * 2 * extraction.board.corners
    assert sum(tag == "image" for tag, _ in page.tags) == legs * 2


def test_overlays_pick_worst_median_and_best(extraction, solution):
    views = leg_views(solution, extraction, make_snapshots(extraction))
    px = solution.residuals.leg_reprojection_px
    assert sorted(view.observation for view in views) == list(range(len(px)))
    assert {view.rank for view in views[3:]} == {""}
    views = views[:3]
    assert [view.error_px for view in views] == [max(px), sorted(px)[len(px) // 2], min(px)]
    assert [view.rank for view in views] == ["worst", "median", "best"]
    worst = int(np.argmax(px))
    np.testing.assert_allclose(
        np.array(views[0].pictures[1].marks)[:, 2:],
        solution.residuals.predicted_right_px[worst] + 0.5,
        atol=0.006,
    )


def test_overlays_use_the_legs_that_have_pictures(extraction, solution):
    first = make_snapshots(extraction)[:1]
    (view,) = leg_views(solution, extraction, first)
    assert (view.rank, view.from_station, view.to_station) == ("only", "0", "1")
    assert leg_views(solution, extraction, ()) == []


def test_a_broken_picture_is_said(solution, extraction):
    broken = (Snapshot(0, 0, b"not a jpeg", b""),)
    assert "cannot be decoded" in Page(page_of(solution, extraction, broken)).text


def hostile_solution(solution, hostile):
    """The solution with the names of a hostile recording."""
    return dataclasses.replace(solution, cameras=hostile.rig.cameras, motion={HOSTILE: 1.0})


def test_hostile_strings_stay_text(solution, extraction):
    hostile = make_hostile(extraction)
    html = page_of(
        hostile_solution(solution, hostile),
        hostile,
        make_snapshots(hostile),
        logs=(LogSource(HOSTILE, HOSTILE),),
        config={HOSTILE: HOSTILE},
        version=HOSTILE,
    )
    page = Page(html)
    assert sum(tag == "script" for tag, _ in page.tags) == 2
    (data,) = re.findall(r'id="data">(.*?)</script>', html, re.DOTALL)
    assert not set("<>&") & set(data)
    assert json.loads(data)["parameters"]["child_frame"] == HOSTILE
    assert "{{7*7}}" in page.text
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e\ud800-\udfff]", html)
    html.encode("utf-8")


def test_the_fewest_stations_make_a_page():
    extraction = make_extraction(n=4)
    solution = make_solution(extraction)
    assert "NOT ENOUGH" in Page(page_of(solution, extraction, make_snapshots(extraction))).text
    assert json.loads(json_text(made(solution, extraction)))["verdict"]["level"] == "NOT ENOUGH"


def test_several_logs_have_a_path_each():
    extraction = make_extraction(n=5, logs=2)
    page = Page(page_of(make_solution(extraction), extraction))
    assert "robot_1.mcap" in page.text
    labels = [attributes.get("aria-label") for _, attributes in page.tags]
    assert labels.count("top view of the base path with cameras and board") == 2
    assert "1:0–1:1" in page.text


def test_the_linear_method_alone(extraction):
    solution = make_solution(extraction, "linear")
    text = Page(page_of(solution, extraction)).text
    assert "The solution was not refined" in text
    assert "iteration of the refinement (0" not in text
    assert json.loads(json_text(made(solution, extraction)))["refinement"] is None


def test_a_head_with_one_joint():
    chain = HeadChain("base_link", "head_link", (JointLink("pan", np.array([0, 0, 1.0])),), pan="pan")
    extraction = make_extraction(n=8)
    solution = make_solution(extraction)
    seen = tuple(
        dataclasses.replace(o, joints=o.joints[:1], joints_std=o.joints_std[:1])
        for o in extraction.observations
    )
    rig = dataclasses.replace(extraction.rig, chain=chain)
    extraction = dataclasses.replace(extraction, rig=rig, observations=seen)
    assert "pan [deg]" in Page(page_of(solution, extraction)).text


def test_gimbal_lock_is_said(extraction, solution):
    locked = Parameters(se3.transform(se3.from_rpy(np.radians([-164, 89.4, -166])), np.zeros(3)), WHEELS)
    solution = dataclasses.replace(solution, parameters=locked)
    assert "0.6° from gimbal lock" in Page(page_of(solution, extraction)).text
    table = summary_text(made(solution, extraction))
    assert "0.6 deg from gimbal lock" in table
    assert "Euler angle x" not in table


def test_many_rejections_are_cut_and_counted(solution, extraction):
    many = tuple(Rejection("vision", "no board", f"n{i}", i) for i in range(205))
    text = Page(page_of(solution, dataclasses.replace(extraction, rejections=many))).text
    assert "report.json lists 5 more" in text
    assert "n199" in text
    assert "n200" not in text


def test_a_long_recording_stays_small():
    extraction = make_extraction(n=100)
    assert len(page_of(make_solution(extraction), extraction).encode()) < 900_000


def test_the_trail_runs_through_the_stations(solution, extraction):
    times = np.array([o.time_ns for o in extraction.observations])
    path = trail(extraction.wheels[0], times, WHEELS)
    ends = solution.residuals.T_w_v[:, :2, 3]
    assert np.linalg.norm(path[-1] - ends[-1]) < 0.03
    nearest = np.linalg.norm(path[None] - ends[:, None], axis=-1).min(axis=1)
    assert np.all(nearest < 0.03)


def test_coverage_counts_cells():
    corners = np.array([[0, 0], [639, 479], [10, 10], [-5, 3], [700, 3]], dtype=np.float64)
    assert image_coverage(corners, 640, 480) == pytest.approx(2 / 48)


def test_visible_escapes_what_steers():
    assert visible("a\x1b[31mé\u202e\udcff\n") == "a\\x1b[31mé\\u202e\\udcff\\n"


@pytest.fixture(scope="module")
def texts(extraction):
    """Every text of a calibration by the default method; a wheel slips once."""
    (track,) = extraction.wheels
    slip = 0.2 * (track.right.time_ns > extraction.observations[5].time_ns + 10**9)
    right = dataclasses.replace(track.right, value=track.right.value + slip)
    slipped = dataclasses.replace(extraction, wheels=(dataclasses.replace(track, right=right),))
    solution = make_solution(slipped, "ml")
    trial = evaluate(extraction, solution.parameters, ROBOT.wheels)
    report = made(solution, slipped, trial)
    checks = "".join(
        f"{check.outcome}: {check.name}: {check.measured_text} ({check.limit_text})\n  {check.why} {check.next_step}\n"
        for check in report.verdict.checks
    )
    past = [dataclasses.replace(robot(std=1e-4), created=f"2015-06-0{day}") for day in (1, 2, 3)]
    past[1] = dataclasses.replace(
        past[1], wheels=WheelGeometry(0.083, 0.082, 0.35), logs=(LogSource("b", "1"),)
    )
    changes = [difference(past[0], other) for other in past[1:]]
    rows = [
        FleetRow(f"robot-{n}", level, code, "the reason", 12, (0.1, 0.0, 0.0), (0.1,) * 6, (1e-3,) * 9)
        for n, (level, code) in enumerate((("PASS", 0), ("FAIL", 6), ("NOT ENOUGH", 6)))
    ]
    page = page_of(solution, slipped, make_snapshots(slipped), trial=trial)
    return {
        "summary": summary_text(report),
        "verdict": f"{report.verdict.level}\n{report.verdict.reason}\n{report.verdict.next_step}\n{checks}",
        "evaluation": evaluation_text(evaluation_data(trial)),
        "comparison": comparison_text(["one", "two", "three"], changes, history(past)),
        "fleet": fleet_text(rows),
        "junit": junit_xml("log.mcap", report.verdict).decode(),
        "page": prose(page),
        "suggestions": "\n".join(suggestion_sentences(solution, slipped)) + "\n",
        "findings": "\n".join(
            [report.quality.reprojection_text, report.uncertainty.jackknife_text, report.error_budget.limiting,
             report.error_budget.advice, *report.outliers_text]
        ) + "\n",
    }  # fmt: skip


def prose(page):
    """The text of a page, one line an element, without tables, plots and images."""
    bare = re.sub(r"<(style|script|svg|table)\b.*?</\1>", "", page, flags=re.DOTALL)
    marked = re.sub(r"</(p|h\d|li|td|th|dt|dd|option|button|summary|div)>", "\n", bare)
    lines = (" ".join(unescape(re.sub(r"<[^>]*>", "", line)).split()) for line in marked.split("\n"))
    return "\n".join(line for line in lines if line) + "\n"


TEXTS = (
    "summary", "verdict", "evaluation", "comparison", "fleet", "junit", "page", "suggestions", "findings"
)  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_each_text_against_its_golden_copy(texts, name):
    assert_golden(texts[name], name)


def test_the_table_shows_clock_offsets_and_two_digits_of_each_sigma(extraction):
    solved = make_solution(extraction, "ml")
    moving = dataclasses.replace(
        solved,
        constants={
            name: EstimatedConstant(name, "clock", "joints", "", value, std, 0.2)
            for name, value, std in (("time_joints", 0.00321, 5e-5), ("time_wheels", -0.0012, 2e-7))
        },
    )
    table = summary_text(made(moving, extraction))
    assert "Cameras to joints                    3.210 ± 0.050 ms" in table
    assert "Cameras to wheels                 -1.20000 ± 0.00020 ms" in table
    assert "± 0.00 " not in table
    assert "Clock" not in summary_text(made(solved, extraction))


def test_the_table_cannot_steer_the_terminal(solution, extraction):
    hostile = make_hostile(extraction)
    table = summary_text(made(hostile_solution(solution, hostile), hostile))
    assert all(character == "\n" or character.isprintable() for character in table)


def test_json_holds_every_number(extraction, solution):
    text = json_text(made(solution, extraction))
    assert text == json_text(made(solution, extraction))
    data = json.loads(text)
    assert text == json.dumps(data, indent=1, sort_keys=True) + "\n"
    assert data["schema_version"] == 5
    assert data["verdict"]["level"] == "PASS"
    assert data["parameters"]["radius_left_mm"] == pytest.approx(
        solution.parameters.wheels.radius_left_m * 1e3, rel=1e-15
    )
    assert len(data["stations"]) == 12
    assert len(data["legs"]) == 11
    assert len(data["linear"]["history"]) == solution.linear.rounds
    second = solution.linear.rival_point_rms_m
    assert data["linear"]["second_best_point_rms_mm"] == pytest.approx(1e3 * second)
    assert math.sqrt(np.mean([leg["point_rms_mm"] ** 2 for leg in data["legs"]])) == pytest.approx(
        data["quality"]["point_rms_mm"]
    )
    assert data["rejections"]["counts"][0] == {
        "stage": "vision", "reason": "board partly hidden", "count": 2,
    }  # fmt: skip


def test_every_kind_of_report_fits_the_schema(extraction):
    two = make_extraction(n=8, logs=2)
    trial = evaluate(extraction, ROBOT_PARAMETERS, ROBOT.wheels)
    change = change_from_nominal(robot(std=1e-4), Nominal(None, WHEELS))
    for report in (
        *(made(make_solution(extraction, method), extraction) for method in ("linear", "lm")),
        made(make_solution(extraction, "ml"), extraction, trial, change),
        made(make_solution(two, "ml"), two),
    ):
        validated(json_text(report))


def test_json_takes_hostile_strings(solution, extraction):
    hostile = make_hostile(extraction)
    text = json_text(made(hostile_solution(solution, hostile), hostile))
    assert text.isascii()
    assert json.loads(text)["notes"] == [HOSTILE]


def test_terms_link_to_their_definitions_once_a_section(html):
    for section in re.findall(r"<section.*?</section>", html, flags=re.DOTALL):
        links = re.findall(r'<a class="term" href="#term-([\w-]+)" title="', section)
        assert len(links) == len(set(links))
    assert {term.key for term in TERMS} >= set(re.findall(r'href="#term-([\w-]+)"', html))
    first = html.index("<h2>The nine parameters</h2>")
    assert re.search(
        r'<a class="term" href="#term-head-eye" title="[^"]+">Head-eye transform</a>', html[first:]
    )


@pytest.mark.parametrize(
    "text", ["leg-work", "<code>station</code>", '<b title="station">x</b>', "<h2>Leg</h2>"]
)
def test_no_links_inside_names_code_and_headings(text):
    assert link_terms(f"<p>{text}</p>") == f"<p>{text}</p>"


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


def robot(wheels=WHEELS, std=None):
    covariance = np.zeros((9, 9)) if std is None else np.eye(9) * std**2
    knowledge = None if std is None else Knowledge(covariance, np.ones(9, dtype=bool))
    return CalibratedRobot("head", "camera", np.eye(4), wheels, knowledge)


def shown_change(extraction, change):
    """Cells of the table of standard deviations that show a change, by parameter."""
    report = made(make_solution(extraction, "ml"), extraction, change=change)
    return {name: cells[2:] for name, cells in rows_of(report, "sigmas").items()}


def test_a_change_from_nominal_values_is_in_units_and_percent(extraction):
    nominal = Nominal(None, dataclasses.replace(WHEELS, separation_m=WHEELS.separation_m - 0.01))
    change = change_from_nominal(robot(std=1e-4), nominal)
    rows = shown_change(extraction, change)
    assert rows["separation"] == ("+10.00", "mm", f"{1000 / (1e3 * WHEELS.separation_m - 10):+.2f}")
    assert rows["t_x"] == ("–", "mm", "–")
    assert np.isnan(change.sigmas).all()


def test_a_change_between_two_calibrations_is_in_sigma(extraction):
    moved = dataclasses.replace(WHEELS, separation_m=WHEELS.separation_m + 0.001)
    rows = shown_change(extraction, change_since(robot(moved, 3e-4), robot(std=4e-4), "before"))
    assert rows["separation"] == ("+1.00", "mm", "+2.0")


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [(12.3456, 0.0073, "12.3456"), (223.06, 0.67, "223.06"), (1234.5, 31.0, "1234"), (2.0, None, "2.000")],
)
def test_values_have_the_digits_of_their_sigma(value, std, shown):
    assert value_text(value, std, 3) == shown


def test_no_sigma_is_shown_as_zero(extraction):
    rows = [FleetRow(f"r{n}", "PASS", 0, "", 12, (0.1, 0, 0), (0.1,) * 6, (1e-7,) * 9) for n in range(2)]
    assert "± 0.00010" in fleet_html(rows)
    assert not re.search(r"± 0\.0*[^0-9.]", fleet_html(rows))


def test_the_square_is_the_measured_one_where_none_is_stated(extraction):
    stated = settings_of(extraction)["board"]
    assert (stated["square_m"], stated["square_from"]) == (0.08, "stated")
    unstated = dataclasses.replace(extraction, board=dataclasses.replace(extraction.board, square_m=None))
    measured = settings_of(unstated)["board"]
    assert measured["square_m"] == np.median([o.square_m for o in extraction.observations])
    assert measured["square_from"] == "measured by the stereo pair"


def test_a_fleet_table_runs_no_formula_and_controls_no_terminal():
    rows = [FleetRow("=HYPERLINK(1)\x1b[31m", "PASS", 0, "fine", 12, (0.0,) * 3, (0.1,) * 6, (1e-3,) * 9)]
    (line,) = csv.DictReader(io.StringIO(fleet_csv(rows)))
    assert line["robot"] == "'=HYPERLINK(1)\\x1b[31m"
    assert "\x1b" not in fleet_text(rows)


@pytest.mark.parametrize("blind", [[3], range(12)])
def test_a_camera_without_corners(extraction, blind):
    """The plots of its corners raised AttributeError and IndexError, and so did its images."""
    seen, none = list(extraction.observations), np.zeros(extraction.board.corners, dtype=bool)
    for i in blind:
        seen[i] = dataclasses.replace(seen[i], right=dataclasses.replace(seen[i].right, seen=none))
    half = dataclasses.replace(extraction, observations=tuple(seen))
    solution, pictures = make_solution(half), make_snapshots(extraction)
    assert "corner residuals across the image of the left camera" in page_of(solution, half, pictures)
    for view in leg_views(solution, half, pictures):
        marks = [len(overlay.marks) for overlay in view.pictures]
        assert marks == [54, 0 if view.observation in blind else 54]
