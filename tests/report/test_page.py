"""The page."""

import base64
import hashlib
import json
import re
from dataclasses import replace

from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.report.formats import json_text
from tests.report.example import (
    HOSTILE,
    Page,
    hostile_solution,
    made,
    make_extraction,
    make_hostile,
    make_snapshots,
    make_solution,
    page_of,
)


def test_the_page_says_what_matters_first(page, solution):
    text = page.text
    assert text.index("PASS") < text.index("wheel separation") < text.index("Checks")
    for words in (
        "rotation x",
        f"{solution.parameters.wheels.radius_right_m:.5f}",
        f"{solution.parameters.wheels.separation_m:.5f}",
        f"{1e3 * solution.point_rms_m:.1f}",
        "12 of 15 (2 board partly hidden)",
        "board partly hidden",
        "head_link",
    ):
        assert words in text


def assert_loads_nothing(page):
    for tag, attributes in page.tags:
        assert tag not in {"iframe", "link", "object", "embed", "img", "form"}
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href"):
            assert re.match(r"#|data:image/jpeg;base64,", attributes.get(name) or "#")


def test_the_page_needs_no_network_and_runs_its_own_script_only(html, page):
    assert_loads_nothing(page)
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


def test_the_page_is_small_and_repeats_byte_for_byte(solution, extraction, html):
    assert len(html.encode()) < 1_000_000
    assert page_of(solution, extraction, make_snapshots(extraction)) == html


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
    assert_loads_nothing(page)
    (data,) = re.findall(r'id="data">(.*?)</script>', html, re.DOTALL)
    assert not set("<>&") & set(data)
    assert json.loads(data)["parameters"]["child_frame"] == HOSTILE
    assert "{{7*7}}" in page.text
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e\ud800-\udfff]", html)
    html.encode("utf-8")


def test_the_linear_method_alone(extraction):
    solution = make_solution(extraction, "linear")
    text = Page(page_of(solution, extraction)).text
    assert "± 1 sigma" not in text
    assert json.loads(json_text(made(solution, extraction)))["refinement"] is None


def test_the_section_that_the_verdict_names_is_open(solution, extraction, html):
    assert "<details" in html
    assert not re.search("<details[^>]* open", html)
    still = replace(solution, motion={"turned_deg": 1.0})
    text = page_of(still, extraction)
    assert re.findall(r'<details class="part" id="(\w+)" open', text) == ["stations"]


def test_a_page_of_a_pass_is_short():
    """Also with every section open; without the labels inside plots."""
    extraction = make_extraction()
    text = page_of(make_solution(extraction, "ml"), extraction, make_snapshots(extraction))
    bare = re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)
    words = [word for word in Page(bare).text.split() if re.search(r"\w", word)]
    assert len(words) < 1200
