"""The pages in a real browser: no network, no complaints, nothing cut off, light, dark and on paper."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import FixedLink, JointLink, Nominal
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.model.solution import Outlier
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.fleet import FleetRow, fleet_html
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.solvers import evaluate, solve
from tests.extractions import Noise, simulated
from tests.report.browser import CHROMIUM, Browser
from tests.report.example import (
    HOSTILE,
    WHEELS,
    fleet_row,
    make_extraction,
    make_snapshots,
    make_solution,
    page_of,
    solved,
)

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: chromium)")


OPEN = "document.querySelectorAll('details').forEach(d => d.open = true)"


@pytest.fixture(scope="module")
def browser():
    with Browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A report with every section: held-out stations, change, outliers, rejections, names that would steer."""
    robot = ROBOTS["paper"]
    noise = Noise(pixel_px=0.2, wheel_rad_per_sqrt_rad=0.003, joint_rad=1e-3)
    extraction = simulated(noise=noise)
    time_ns = extraction.observations[3].time_ns
    extraction = replace(
        extraction,
        logs=(LogSource(HOSTILE, "0" * 64),),
        rejections=(Rejection("vision", "blurred", HOSTILE, time_ns, log=0, station=20),),
        notes=(HOSTILE, "a very-long-word-" * 20),
    )
    solution = solve(extraction)
    outliers = tuple(
        Outlier(kind, 0, (1,), time_ns, f"{kind} {HOSTILE}")
        for kind in ("station", "slip", "joint", "corners")
    )
    solution = replace(solution, outliers=outliers)
    trial = evaluate(extraction, solution.parameters, robot.wheels)
    change = Change(HOSTILE, np.linspace(-1, 1, 9) * 1e-3, np.linspace(-3, 3, 9), np.full(9, np.nan), 0.2)
    rejected = replace(make_snapshots(extraction)[0], station=20, jpegs={})
    text = page_of(solution, extraction, (*make_snapshots(extraction), rejected), trial=trial, change=change)
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("width", [360, 1000])
@pytest.mark.parametrize("dark", [False, True])
def test_the_report_fits_every_screen(browser, page, width, dark):
    browser.open(page, width=width, dark=dark)
    assert browser.requests() == [page.absolute().as_uri()]
    assert browser.complaints() == []
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    for detail in range(browser.evaluate("document.querySelectorAll('details').length")):
        browser.evaluate(f"document.querySelectorAll('details')[{detail}].open = true")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    # Nothing of the verdict is below the first screen's fold.
    assert browser.evaluate("document.querySelector('.verdict').getBoundingClientRect().bottom") < 900
    assert browser.evaluate("document.querySelector('.screen').getBoundingClientRect().bottom") < 2 * 900
    sigmas = (
        "Math.max(...[...document.querySelectorAll('.numbers td')].map(e => e.getBoundingClientRect().right))"
    )
    assert browser.evaluate(sigmas) <= width
    # The smallest text is still text.
    smallest = browser.evaluate(
        "Math.min(...[...document.querySelectorAll('p,td,th,li,figcaption')].map("
        "e => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert smallest >= 12


@pytest.mark.parametrize("dark", [False, True])
def test_colours_have_contrast(browser, page, dark):
    """WCAG's contrast of text and ground, at least 4.5 to 1 for running text."""
    browser.open(page, dark=dark)
    pairs = {
        "p.say": ".numbers",
        "td": ".numbers",
        ".bar button": ".bar button",
        "nav a": "body",
        "summary h2": "details.part",
    }
    levels = {f".verdict.{level} p": f".verdict.{level}" for level in ("pass", "fail", "short")}
    tags = {f".tag.{kind}": f".tag.{kind}" for kind in ("pass", "fail", "short")}
    for text, ground in (pairs | levels | tags).items():
        name, _, kind = ground.partition(".")[2].partition(".")
        if ground in levels.values() or ground in tags.values():
            browser.evaluate(f"document.querySelector('.{name}').className = '{name} {kind}'")
        colours = browser.evaluate(
            f"[getComputedStyle(document.querySelector('{text}')).color, "
            f"getComputedStyle(document.querySelector('{ground}')).backgroundColor].join('|')"
        ).split("|")
        assert contrast(*colours) >= 4.5, (text, colours)


def contrast(first: str, second: str) -> float:
    levels = []
    for colour in (first, second):
        channels = np.array([float(c) for c in re.findall(r"[\d.]+", colour)[:3]]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        levels.append(float(linear @ [0.2126, 0.7152, 0.0722]) + 0.05)
    return max(levels) / min(levels)


def test_a_station_lights_up_everywhere(browser, page):
    """By the keyboard, by a bar of a plot, and in the view; turning and zooming redraws it."""
    browser.open(page, width=1200)
    browser.evaluate(OPEN)
    lit = "[...document.querySelectorAll('svg.plot')].filter(p => p.querySelector('.on')).length"
    assert browser.evaluate(lit) == 0
    browser.evaluate("document.getElementById('next').focus()")
    browser.key("Enter")
    assert browser.evaluate("document.getElementById('station').value") == "0"
    assert browser.evaluate(lit) >= 5
    assert browser.evaluate("document.querySelectorAll('#images image').length") == 2
    assert "heading 0°" in browser.evaluate("document.getElementById('picked').textContent")
    browser.evaluate(
        "document.querySelector('rect[data-s=\"3 4\"]').dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )
    assert browser.evaluate("document.getElementById('station').value") == "3"
    browser.evaluate("document.getElementById('view').focus()")
    picture = "document.getElementById('view').toDataURL()"
    seen = {browser.evaluate(picture)}
    for key in ("ArrowLeft", "ArrowUp", "+", "n"):
        browser.key(key)
        seen.add(browser.evaluate(picture))
    assert len(seen) == 5
    assert browser.evaluate("document.getElementById('station').value") == "4"
    browser.key("Escape")
    assert browser.evaluate(lit) == 0
    assert browser.complaints() == []


def test_the_robot_stands_as_its_chain_says(browser, tmp_path):
    """The script's own kinematics against Python's, with a sliding and a mimicking joint."""
    extraction = make_extraction(n=4)
    chain = extraction.rig.chain
    lift = JointLink("lift", np.array([0.0, 0, 1]), "prismatic", multiplier=2.0, offset=0.3)
    again = JointLink(chain.joints[0], np.array([0.6, 0, 0.8]), multiplier=-0.5, offset=0.2)
    links = (FixedLink(se3.exp(np.array([0.1, 0.2, 0.3, 0.4, 0, 1]))), *chain.links, lift, again)
    joints = np.array([0.3, -0.7, 0.25])
    seen = tuple(replace(o, joints=joints, joints_std=joints) for o in extraction.observations)
    chain = replace(chain, links=links)
    solution = make_solution(extraction)
    T_nominal = se3.exp(np.array([0.2, 0.1, -0.3, 0.05, 0.02, -0.04]))
    rig = replace(extraction.rig, chain=chain, nominal=Nominal(T_nominal, WHEELS))
    path = tmp_path / "report.html"
    path.write_text(page_of(solution, replace(extraction, rig=rig, observations=seen)), encoding="utf-8")
    browser.open(path, width=1000)
    browser.evaluate(OPEN)
    picture = "document.getElementById('view').toDataURL()"
    before = browser.evaluate(picture)
    browser.evaluate("document.getElementById('next').click()")
    browser.evaluate("document.getElementById('robot').click()")
    said = browser.evaluate("document.getElementById('picked').textContent")
    T_v_h = head_pose(chain, joints)
    for label, T in (("estimated", solution.T_h_reference), ("nominal", T_nominal)):
        numbers = re.search(rf"{label} camera at ([-\d., ]+) m", said).group(1)
        np.testing.assert_allclose([float(n) for n in numbers.split(", ")], (T_v_h @ T)[:3, 3], atol=6e-5)
    assert browser.evaluate(picture) != before
    browser.evaluate("document.getElementById('robot').click()")
    assert "heading" in browser.evaluate("document.getElementById('picked').textContent")
    assert browser.complaints() == []


def test_the_keyboard_reaches_every_control(browser, page):
    browser.open(page)
    browser.evaluate(OPEN)
    wanted = browser.evaluate("[...document.querySelectorAll('button,select,summary,canvas')].length")
    reached = set()
    for _ in range(400):
        browser.key("Tab")
        at = "[document.activeElement.tagName, [...document.querySelectorAll('*')].indexOf(document.activeElement)].join()"
        reached.add(browser.evaluate(at))
    assert sum(each.split(",")[0] in {"BUTTON", "SELECT", "SUMMARY", "CANVAS"} for each in reached) == wanted


def test_without_scripts_all_plots_are_there(browser, page):
    browser.open(page)
    plots = browser.evaluate("document.querySelectorAll('svg.plot').length")
    browser.scripts(False)
    try:
        browser.open(page)
        text = browser.text()
    finally:
        browser.scripts(True)
    assert plots > 7
    assert "Robot description" in text
    assert "Previous" not in text  # nothing that needs the script is shown


def test_no_label_lies_over_another(browser, page):
    """Bounding boxes of the texts of each plot, at phone and desk width."""
    overlap = """[...document.querySelectorAll('svg.plot')].flatMap(plot => {
      const boxes = [...plot.querySelectorAll('text:not([transform])')].map(t => [t.textContent, t.getBoundingClientRect()]);
      return boxes.flatMap(([a, p], i) => boxes.slice(i + 1).filter(([b, q]) =>
        Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1 && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 3
        && p.width && q.width).map(([b]) => `${plot.getAttribute('aria-label')}: ${a} | ${b}`));
    })"""
    sizes = """[...document.querySelectorAll('svg.plot text')].filter(t => t.getBoundingClientRect().width)
      .map(t => parseFloat(getComputedStyle(t).fontSize) * t.getScreenCTM().a)"""
    for width in (390, 1200):
        browser.open(page, width=width)
        browser.evaluate(OPEN)
        assert browser.evaluate(overlap) == []
        assert min(browser.evaluate(sizes)) > 9  # px; legends of the first screen had 5 on a phone


@pytest.mark.parametrize("level", ["PASS", "NOT ENOUGH", "FAIL"])
def test_it_prints_one_sheet_to_sign(browser, tmp_path, level):
    """A4, with verdict, numbers, recording, hash, date and lines for robot and signature."""
    solution, extraction = solved()
    gates = {"predicted.camera_mm": 0.1} if level == "NOT ENOUGH" else {}
    if level == "FAIL":
        wide = replace(WHEELS, separation_m=3 * solution.parameters.wheels.separation_m)
        extraction = replace(
            extraction, rig=replace(extraction.rig, nominal=replace(extraction.rig.nominal, wheels=wide))
        )
    path = tmp_path / "report.html"
    path.write_text(page_of(solution, extraction, make_snapshots(extraction), gates=gates), encoding="utf-8")
    browser.open(path, dark=True)
    pdf = browser.pdf()
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 1
    (size,) = re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    np.testing.assert_allclose([float(points) for points in size], [595.3, 841.9], atol=1)
    browser.call("Emulation.setEmulatedMedia", media="print")
    text = browser.text()
    browser.call("Emulation.setEmulatedMedia", media="")
    assert text.startswith(f"{level}\n")
    for words in ("wheel separation", "log.mcap", f"SHA-256 {'0' * 64}", "Calibrated", "Robot", "Signature"):
        assert words in text
    assert "Checks" not in text


def test_the_first_screen_has_150_words_and_scrolling_stays_the_page_s(browser, page):
    browser.open(page, width=1280)
    words = """(() => { const walk = document.createTreeWalker(document.querySelector('main'), NodeFilter.SHOW_TEXT); let n = 0;
      while (walk.nextNode()) { const range = document.createRange(); range.selectNodeContents(walk.currentNode);
        const box = range.getBoundingClientRect();
        if (box.width && box.top < innerHeight && walk.currentNode.parentElement.checkVisibility())
          n += walk.currentNode.data.split(/\\s+/).filter(w => /[\\p{L}\\p{N}]/u.test(w)).length; }
      return n; })()"""
    assert 50 < browser.evaluate(words) <= 150
    browser.evaluate("document.querySelector('nav a[href=\"#stations\"]').click()")
    deadline = time.monotonic() + 5
    while not browser.evaluate("document.getElementById('stations').open") and time.monotonic() < deadline:
        time.sleep(0.05)
    assert browser.evaluate("document.getElementById('stations').open")
    stolen = "!document.getElementById('view').dispatchEvent(new WheelEvent('wheel', {deltaY: 9, cancelable: true, ctrlKey: CTRL}))"
    assert browser.evaluate(stolen.replace("CTRL", "false")) is False
    assert browser.evaluate(stolen.replace("CTRL", "true")) is True


def test_the_fleet_s_table(browser, tmp_path):
    rows = [fleet_row(f"robot-{n}", turn=(0.1, n * 1e-4, 0)) for n in range(8)]
    rows.append(FleetRow("broken", "ERROR", 3, HOSTILE))
    path = tmp_path / "summary.html"
    path.write_text(fleet_html(rows), encoding="utf-8")
    for width in (360, 1400):
        browser.open(path, width=width)
        assert browser.complaints() == []
        assert browser.requests() == [path.absolute().as_uri()]
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate("document.querySelectorAll('.robots tbody tr').length") == 9
    for width, height in ((1200, 800), (390, 844)):
        browser.open(path, width=width, height=height)
        bottoms = (
            "[...document.querySelectorAll('.robots tbody tr')].map(r => r.getBoundingClientRect().bottom)"
        )
        assert sum(bottom <= height for bottom in browser.evaluate(bottoms)) >= 6
    browser.open(path, width=1200)
    wide = "document.querySelector('.scroll').scrollWidth > document.querySelector('.scroll').clientWidth"
    assert browser.evaluate(wide) is False  # all columns fit
