"""The checks of the verdict, or the robots of a fleet, as JUnit XML for CI systems."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.fleet import FleetRow
from mobilecal_cli.report.verdict import LEVELS, Verdict


class _Case(NamedTuple):
    """A test case; `tag` is "failure", "error", or "" for one that passes, and `out` what it printed."""

    name: str
    tag: str
    message: str
    kind: str
    text: str
    out: str = ""
    seconds: float = 0.0


def junit_xml(name: str, verdict: Verdict, seconds: float = 0.0) -> bytes:
    """A test suite, for example of a recording: each check is a case, failed also where there is too little data.

    The time is that of the whole suite: one solution is judged by all checks.
    """
    cases = []
    for check in verdict.checks:
        tag, warning = "failure" if check.outcome in LEVELS else "", check.outcome == "warning"
        out = f"measured: {check.measured_text}; limit: {check.limit_text}"
        out += f"; warning: {check.why}" if warning else ""
        cases.append(_Case(check.name, tag, check.why, check.label, check.next_step, out))
    return _xml(name, cases, seconds)


def junit_error_xml(name: str, error: MobilecalError) -> bytes:
    """One test case with the error that ended a run without a result."""
    case = _Case("the recording can be calibrated", "error", error.message, error.code, error.hint)
    return _xml(name, [case])


def junit_fleet_xml(name: str, rows: Sequence[FleetRow]) -> bytes:
    """A test suite of a directory of recordings: each robot is a case, an error if it has no result."""
    tags = {"PASS": "", "ERROR": "error"}
    cases = [
        _Case(
            row.name,
            tags.get(row.verdict, "failure"),
            row.reason,
            row.verdict.lower(),
            row.hint,
            seconds=row.seconds,
        )
        for row in rows
        if row.verdict != "SKIPPED"
    ]
    return _xml(name, cases)


def is_junit(path: Path) -> bool:
    """Whether a file is one that this module wrote: a later run may replace it."""
    try:
        with path.open("rb") if path.is_file() else BytesIO() as stream:
            return b'classname="mobilecal"' in stream.read(4096)
    except OSError:
        return False


def _xml(name: str, cases: Sequence[_Case], seconds: float = 0.0) -> bytes:
    counts = {"tests": str(len(cases))}
    counts |= {f"{tag}s": str(sum(case.tag == tag for case in cases)) for tag in ("failure", "error")}
    counts["time"] = f"{seconds or sum(case.seconds for case in cases):.3f}"
    suites = ET.Element("testsuites", counts)
    suite = ET.SubElement(suites, "testsuite", {"name": visible(name), **counts})
    for case in cases:
        about = {"classname": "mobilecal", "name": visible(case.name), "time": f"{case.seconds:.3f}"}
        element = ET.SubElement(suite, "testcase", about)
        if case.tag:
            child = ET.SubElement(element, case.tag, {"message": visible(case.message), "type": case.kind})
            child.text = visible(case.text)
        if case.out:
            ET.SubElement(element, "system-out").text = visible(case.out)
    ET.indent(suites)
    return bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True)) + b"\n"
