"""The criteria of the verdict as numbers, in the order in which they decide. Their sentences are in `wording`."""

from mobilecal_cli.report.checks.all import all_checks

__all__ = ["all_checks"]
