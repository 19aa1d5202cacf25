"""Recordings that can be read and are wrong: none passes with a wrong result, unless it cannot be seen."""

from __future__ import annotations

import pytest

from tests.hostile.meaning import OUTCOMES, WRONG, outcome, recorded


def test_there_are_at_least_sixty():
    assert len(WRONG) >= 60
    assert len(recorded().observations) == 20


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_recording_is_refused_fails_or_does_no_harm(name):
    found = outcome(name)
    assert found.kind in OUTCOMES
    if not WRONG[name].unseen:
        assert found.kind != "PASS, wrong", f"{found.sigmas:.1f} sigma"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("sign of the left wheel", "refused, right cause"),
        ("gear ratio 2 of both wheels", "FAIL, right cause"),
        ("wheels 0.3 s late", "PASS, right"),
    ],
)
def test_outcomes(name, kind):
    assert outcome(name).kind == kind
