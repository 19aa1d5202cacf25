"""JUnit files for CI: the criteria of a run, or what kept it from an answer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.export import write_file
from mobilecal_cli.report import Check, junit_error_xml, junit_xml


def write_junit(path: Path, name: str, checks: Sequence[Check], force: bool) -> None:
    """Every criterion as a test case.

    Raises:
        OutputError: the file cannot be written.
    """
    write_file(path, junit_xml(name, checks), force)


def write_junit_error(path: Path, name: str, error: MobilecalError, force: bool) -> None:
    """A run without an answer as one test case with an error.

    Raises:
        OutputError: the file cannot be written.
    """
    write_file(path, junit_error_xml(name, error), force)
