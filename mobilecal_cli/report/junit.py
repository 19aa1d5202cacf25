"""The checks of the verdict, or the robots of a fleet, as JUnit XML for CI systems."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model import FleetRow
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.verdict import VerdictData

_FAILURES = ("fail", "not_enough")


def junit_xml(name: str, verdict: VerdictData) -> bytes:
    """One test case per check: failed if it fails, or if there is too little data to decide.

    Args:
        name: name of the test suite, for example the recording.
        verdict: the checks with their sentences.
    """
    suites, suite = _suites(
        name, len(verdict.checks), failures=sum(c.outcome in _FAILURES for c in verdict.checks)
    )
    for check in verdict.checks:
        case = _case(suite, check.name)
        if check.outcome in _FAILURES:
            _said(case, "failure", check.why, check.outcome.replace("_", " "), check.next_step)
        warning = f"; warning: {check.why}" if check.outcome == "warning" else ""
        out = ET.SubElement(case, "system-out")
        out.text = visible(f"measured: {check.measured_text}; limit: {check.limit_text}{warning}")
    return _written(suites)


def junit_error_xml(name: str, error: MobilecalError) -> bytes:
    """One test case with the error that ended a run without a result."""
    suites, suite = _suites(name, 1, errors=1)
    _said(_case(suite, "the recording can be calibrated"), "error", error.message, error.code, error.hint)
    return _written(suites)


def junit_fleet_xml(name: str, rows: Sequence[FleetRow]) -> bytes:
    """One test case per robot: failed if it does not pass, an error if it has no result.

    Args:
        name: name of the test suite, for example the directory of the recordings.
        rows: the robots.
    """
    robots = [row for row in rows if row.verdict != "SKIPPED"]
    errors = sum(row.verdict == "ERROR" for row in robots)
    failures = sum(row.verdict != "PASS" for row in robots) - errors
    suites, suite = _suites(name, len(robots), failures, errors)
    for row in robots:
        case = _case(suite, row.name)
        if row.verdict != "PASS":
            tag = "error" if row.verdict == "ERROR" else "failure"
            _said(case, tag, row.reason, row.verdict.lower(), row.hint)
    return _written(suites)


def is_junit(path: Path) -> bool:
    """Whether a file is one that this module wrote: a later run may replace it."""
    try:
        with path.open("rb") if path.is_file() else BytesIO() as stream:
            return b'classname="mobilecal"' in stream.read(4096)
    except OSError:
        return False


def _suites(name: str, tests: int, failures: int = 0, errors: int = 0) -> tuple[ET.Element, ET.Element]:
    counts = {"tests": str(tests), "failures": str(failures), "errors": str(errors)}
    suites = ET.Element("testsuites", counts)
    return suites, ET.SubElement(suites, "testsuite", {"name": visible(name), **counts})


def _case(suite: ET.Element, name: str) -> ET.Element:
    return ET.SubElement(suite, "testcase", {"classname": "mobilecal", "name": visible(name)})


def _said(case: ET.Element, tag: str, message: str, kind: str, text: str) -> None:
    ET.SubElement(case, tag, {"message": visible(message), "type": kind}).text = visible(text)


def _written(suites: ET.Element) -> bytes:
    ET.indent(suites)
    return bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True)) + b"\n"
