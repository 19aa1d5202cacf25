"""Figures drawn by another process are the same; if that process fails, this one draws them."""

from __future__ import annotations

import os
import signal

import pytest

from mobilecal_cli.pipeline import processes
from mobilecal_cli.pipeline.drawing import Draughtsman
from mobilecal_cli.report import draw_figures
from tests.report.example import make_extraction, make_solution


@pytest.fixture(scope="module")
def drawn():
    extraction = make_extraction()
    solution = make_solution(extraction)
    return solution, extraction, draw_figures(solution, extraction)


def begin(draughtsman: Draughtsman, extraction) -> list[str]:
    told = []
    progress = draughtsman.watching(lambda stage, *_: told.append(stage))
    progress("reading", 0, None)
    assert not draughtsman.started
    progress("detecting the board", 1, 2)
    progress("detecting the board", 2, 2)
    draughtsman.begin_with(extraction)
    return told


def test_another_process_draws_the_same(drawn):
    solution, extraction, here = drawn
    with Draughtsman(2) as draughtsman:
        assert begin(draughtsman, extraction) == ["reading", "detecting the board", "detecting the board"]
        assert draughtsman.started
        there = draughtsman.begin(solution, extraction)()
    assert there == here


def test_one_job_is_this_process(drawn):
    solution, extraction, here = drawn
    with Draughtsman(1) as draughtsman:
        begin(draughtsman, extraction)
        assert not draughtsman.started
        assert draughtsman.begin(solution, extraction)() == here


def test_a_process_that_dies_is_no_loss(drawn):
    solution, extraction, here = drawn
    with Draughtsman(2) as draughtsman:
        begin(draughtsman, extraction)
        assert draughtsman.started
        os.kill(draughtsman.submit(os.getpid).result(), signal.SIGKILL)
        assert draughtsman.begin(solution, extraction)() == here


def test_where_no_process_can_be_started_all_is_drawn_here(drawn, monkeypatch):
    solution, extraction, here = drawn

    def refused(*_args, **_kwargs):
        raise OSError("no processes here")

    monkeypatch.setattr(processes, "ProcessPoolExecutor", refused)
    with Draughtsman(2) as draughtsman:
        begin(draughtsman, extraction)
        assert draughtsman.begin(solution, extraction)() == here
