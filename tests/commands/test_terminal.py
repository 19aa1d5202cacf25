"""What a terminal shows: the verdict once, in color, and progress that moves."""

import io
import json
import os
import pty
import subprocess
import sys
import time

import pytest

from mobilecal_cli.commands.terminal import open_page, verdict_text
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.report.verdict import Verdict
from tests.command import run
from tests.report.example import make_extraction


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("level", "color"), [("PASS", "32"), ("FAIL", "31"), ("NOT ENOUGH", "33")])
def test_the_level_has_a_color_on_a_terminal_only(monkeypatch, level, color):
    monkeypatch.delenv("NO_COLOR", raising=False)
    plain = f"{level}: Because.\nNext: Go on."
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert verdict_text(Verdict(level, "Because.", "Go on.")) == plain
    colored = f"\x1b[1;{color}m{level}\x1b[0m: Because.\nNext: Go on."
    assert verdict_text(Verdict(level, "Because.", "Go on."), to_stderr=True) == colored
    monkeypatch.setenv("NO_COLOR", "1")
    assert verdict_text(Verdict(level, "Because.", "Go on."), to_stderr=True) == plain


def test_a_verdict_cannot_control_the_terminal():
    assert "\x1b" not in verdict_text(Verdict("FAIL", "joint \x1b[2J", "topic \x1b[2J"))


@pytest.mark.long
def test_the_verdict_stands_once(sample_logs, tmp_path):
    shown = run("calibrate", sample_logs / "straight.mcap", "-o", "out", cwd=tmp_path)
    assert shown.code == 6
    assert shown.err == ""
    assert shown.out.count("NOT ENOUGH: The wheel separation is not determined") == 1
    assert shown.out.count("Next: Record again") == 1
    assert "± 0.10 m not determined" in " ".join(shown.out.split())
    again = ("calibrate", tmp_path / "out/extraction.npz", "-o", "again", "--force")
    quiet = run(*again, "--quiet", cwd=tmp_path)
    assert (quiet.code, quiet.out) == (6, "")
    assert quiet.err.startswith("NOT ENOUGH: The wheel separation is not determined")
    assert "Written: again/params.yaml, again/report.html" in quiet.err
    program = run(*again, "--json", cwd=tmp_path)
    assert program.code == 6
    assert json.loads(program.out)["verdict"]["level"] == "NOT ENOUGH"
    assert program.err == quiet.err


def test_steps_of_unknown_number_are_counted():
    code = (
        "import time\n"
        "from mobilecal_cli.commands.terminal import progress_bar\n"
        "with progress_bar() as show:\n"
        "    show('reading', 3, 7); time.sleep(0.3)\n"
        "    show('solving', 37, None); time.sleep(0.3)\n"
    )
    master, slave = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    subprocess.run([sys.executable, "-c", code], stderr=slave, check=True, env=environment)
    os.close(slave)
    shown = os.read(master, 100_000).decode()
    os.close(master)
    reading, _, solving = shown.partition("solving")
    assert "3/7" in reading
    assert "━" in reading
    assert "37 steps" in solving


def test_the_report_is_opened_without_waiting(tmp_path, monkeypatch):
    """A browser that stays open does not hold up the command."""
    page, seen, browser = tmp_path / "report.html", tmp_path / "seen", tmp_path / "browser"
    page.write_text("<p>", encoding="utf-8")
    browser.write_text(f'#!/bin/sh\necho "$1" > {seen}.part\nmv {seen}.part {seen}\nsleep 5\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    began = time.monotonic()
    assert open_page(page) == f"Opening the report in a browser: {page}"
    assert time.monotonic() - began < 4
    while not seen.exists() and time.monotonic() - began < 60:
        time.sleep(0.05)
    assert seen.read_text().strip() == page.as_uri()


def test_without_a_display_the_report_is_named(tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "e.npz").write_bytes(extraction_to_npz(make_extraction()))
    done = run("calibrate", "e.npz", "-o", "out", "--open", "--quiet", "--method", "linear", cwd=tmp_path)
    assert f"No display to open the report on: {tmp_path / 'out' / 'report.html'}\n" in done.err
