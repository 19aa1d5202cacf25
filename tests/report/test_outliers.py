"""Outliers in words: a few singly, many by count."""

from dataclasses import replace

from mobilecal_cli.model import Outlier
from mobilecal_cli.report.checks import outliers_as_noise
from mobilecal_cli.report.criteria import Calibration
from mobilecal_cli.report.findings import outlier_sentences
from mobilecal_cli.simulate.ideal import ideal_extraction
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.simulate.route import plan_route
from tests.report.example import make_extraction, make_solution

EXTRACTION = ideal_extraction(paper_robot(), plan_route(paper_robot(), stations=8))


def moved(*stations):
    return [Outlier("station", 0, (i,), i, f"Station {i} is off.") for i in stations]


def test_a_few_are_listed_singly():
    slip = Outlier("slip", 0, (2, 3), 3, "Slip.")
    assert list(outlier_sentences([slip, *moved(1, 5)], EXTRACTION)) == [
        "Station 1 is off.",
        "Station 5 is off.",
        "Slip.",
    ]


def test_many_are_grouped_with_their_count():
    (sentence,) = outlier_sentences(moved(1, 2, 5, 7), EXTRACTION)
    assert sentence.startswith("4 stations whose images do not fit")
    assert "(1, 2, 5, 7)" in sentence
    assert sentence.endswith("The first: Station 1 is off.")


def test_many_slips_are_named_by_their_legs():
    slips = [Outlier("slip", 0, (i, i + 1), i, "Slip.") for i in range(4)]
    (sentence,) = outlier_sentences(slips, EXTRACTION)
    assert "(0-1, 1-2, 2-3, 3-4)" in sentence


def test_noise_is_named_by_its_kind():
    solution = make_solution(make_extraction(), "ml")

    def said(*kinds):
        made = Calibration(replace(solution, noisy=kinds), make_extraction())
        (check,) = outliers_as_noise(made)
        assert (check.value, check.limit, check.outcome) == (len(kinds), 0, "warning")
        return check.why

    assert "joint readings differ" in said("readings")
    assert "legs' wheel rotations and of the joint readings" in said("legs", "readings")
