"""JUnit files for CI: the criteria of a run, or the error that ended it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.export import write_file
from mobilecal_cli.report import Check, junit_error_xml, junit_xml


def write_junit(path: Path, name: str, checks: Sequence[Check], force: bool) -> None:
    """Write every criterion as a test case.

    Raises:
        OutputError: the file cannot be written.
    """
    write_file(path, junit_xml(name, checks), force)


def write_junit_error(path: Path, name: str, error: MobilecalError, force: bool) -> None:
    """Write the error that ended a run as one test case.

    Raises:
        OutputError: the file cannot be written.
    """
    write_file(path, junit_error_xml(name, error), force)
