"""The checks of the verdict as JUnit XML for CI systems."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import OUTCOME_LABELS, Check
from mobilecal_cli.report.wording import words


def junit_xml(name: str, checks: Sequence[Check]) -> bytes:
    """One test case per check: failed if it fails, or if there is too little data to decide.

    Args:
        name: name of the test suite, for example the recording.
        checks: the checks.
    """
    failed = [check for check in checks if check.outcome in ("bad", "short")]
    counts = {"tests": str(len(checks)), "failures": str(len(failed)), "errors": "0"}
    suites = ET.Element("testsuites", counts)
    suite = ET.SubElement(suites, "testsuite", {"name": visible(name), **counts})
    for check in checks:
        said = words(check)
        case = ET.SubElement(suite, "testcase", {"classname": "mobilecal", "name": visible(said.name)})
        if check.outcome in ("bad", "short"):
            failure = ET.SubElement(
                case, "failure", {"message": visible(said.why), "type": OUTCOME_LABELS[check.outcome]}
            )
            failure.text = visible(said.next_step)
        out = ET.SubElement(case, "system-out")
        out.text = visible(f"measured: {said.measured}; limit: {said.limit}")
        if check.outcome == "look":
            out.text += visible(f"; warning: {said.why}")
    return _written(suites)


def junit_error_xml(name: str, error: MobilecalError) -> bytes:
    """One test case with the error that ended a run without a result."""
    counts = {"tests": "1", "failures": "0", "errors": "1"}
    suites = ET.Element("testsuites", counts)
    suite = ET.SubElement(suites, "testsuite", {"name": visible(name), **counts})
    case = ET.SubElement(
        suite, "testcase", {"classname": "mobilecal", "name": "the recording can be calibrated"}
    )
    told = ET.SubElement(case, "error", {"message": visible(error.message), "type": error.code})
    told.text = visible(error.hint)
    return _written(suites)


def _written(suites: ET.Element) -> bytes:
    ET.indent(suites)
    return bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True)) + b"\n"
