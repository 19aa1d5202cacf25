"""The checks of the verdict, or the robots of a fleet, as JUnit XML for CI systems."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.fleet import FleetRow, robots_of
from mobilecal_cli.report.verdict import Verdict


def junit_xml(name: str, verdict: Verdict, seconds: float = 0.0) -> bytes:
    """A test suite, for example of a recording: each check is a case, failed also where there is too little data.

    The time is that of the whole suite: one solution is judged by all checks.
    """
    cases = []
    for check in verdict.checks:
        tag, warning = "" if check.met else "failure", check.outcome == "warning"
        out = f"measured: {check.measured_text}; limit: {check.limit_text}"
        out += f"; warning: {check.why}" if warning else ""
        cases.append(_case(check.name, tag, check.why, check.label, check.next_step, out))
    return _xml(name, cases, seconds)


def junit_error_xml(name: str, error: MobilecalError) -> bytes:
    """One test case with the error that ended a run without a result."""
    case = _case("the recording can be calibrated", "error", error.message, error.code, error.hint)
    return _xml(name, [case], 0.0)


def junit_fleet_xml(name: str, rows: Sequence[FleetRow]) -> bytes:
    """A test suite of a directory of recordings: each robot is a case, an error if it has no result."""
    tags = {"PASS": "", "ERROR": "error"}
    cases = [
        _case(r.name, tags.get(r.verdict, "failure"), r.reason, r.verdict.lower(), r.hint, seconds=r.seconds)
        for r in robots_of(rows)
    ]
    return _xml(name, cases, sum(row.seconds for row in rows))


def is_junit(path: Path) -> bool:
    """Whether a file is one that this module wrote: a later run may replace it."""
    try:
        with path.open("rb") if path.is_file() else BytesIO() as stream:
            return b'classname="mobilecal"' in stream.read(4096)
    except OSError:
        return False


def _case(
    name: str, tag: str, message: str, kind: str, text: str, out: str = "", seconds: float = 0.0
) -> ET.Element:
    """A test case; `tag` is "failure", "error", or "" for one that passes, and `out` what it printed."""
    about = {"classname": "mobilecal", "name": visible(name), "time": f"{seconds:.3f}"}
    case = ET.Element("testcase", about)
    if tag:
        ET.SubElement(case, tag, message=visible(message), type=kind).text = visible(text)
    if out:
        ET.SubElement(case, "system-out").text = visible(out)
    return case


def _xml(name: str, cases: Sequence[ET.Element], seconds: float) -> bytes:
    counts = {"tests": str(len(cases))}
    counts |= {
        f"{tag}s": str(sum(case.find(tag) is not None for case in cases)) for tag in ("failure", "error")
    }
    counts["time"] = f"{seconds:.3f}"
    suites = ET.Element("testsuites", counts)
    ET.SubElement(suites, "testsuite", {"name": visible(name), **counts}).extend(cases)
    ET.indent(suites)
    return bytes(ET.tostring(suites, encoding="utf-8", xml_declaration=True)) + b"\n"
