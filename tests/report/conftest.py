"""One calibration that most tests report on, and its page."""

import pytest

from tests.report.example import Page, make_extraction, make_snapshots, make_solution, page_of


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
