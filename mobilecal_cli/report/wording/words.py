"""What the sentences of one criterion are."""

from __future__ import annotations

from typing import NamedTuple

from mobilecal_cli.report.check import Check


class Words(NamedTuple):
    """What is said about a criterion.

    Attributes:
        name: the criterion.
        measured, limit: values with their units.
        why: a sentence for every outcome but "pass".
        next_step: what to do then.
    """

    name: str
    measured: str
    limit: str
    why: str = ""
    next_step: str = ""


def part(check: Check) -> str:
    """The part of a criterion's id after the first dot."""
    return check.id.partition(".")[2]
