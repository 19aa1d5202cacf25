"""One calibration that most tests report on, and its page."""

import pytest

from tests.report.example import Page, make_extraction, make_snapshots, make_solution, page_of


@pytest.fixture(scope="module")
def extraction():
    return make_extraction()


@pytest.fixture(scope="module")
def solution(extraction):
    return make_solution(extraction)


@pytest.fixture(scope="session")
def html():
    extraction = make_extraction()
    return page_of(make_solution(extraction), extraction, make_snapshots(extraction))


@pytest.fixture(scope="session")
def page(html):
    return Page(html)
