"""All sentences of the criteria. A new criterion has its words here and its numbers in `checks`."""

from mobilecal_cli.report.check import Check
from mobilecal_cli.report.wording import calibration, evaluation
from mobilecal_cli.report.wording.words import Words

__all__ = ["Words", "words"]

_WORDS = {**calibration.WORDS, **evaluation.WORDS}


def words(check: Check) -> Words:
    """The sentences of a criterion. Names from a recording are escaped."""
    return _WORDS[check.id.partition(".")[0]](check)
