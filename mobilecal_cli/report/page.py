"""report.html: the report as one file that needs no network; without scripts, texts, tables and plots are there.

Terms have their definitions as tooltips; docs/reference/glossary.md defines the same terms.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mobilecal_cli.model import Snapshot
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.criteria import section_of
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.numbers import percent_text
from mobilecal_cli.report.plots import budget_bar, leg_views, path_picture, plots, thumbnails
from mobilecal_cli.report.svg import STYLE
from mobilecal_cli.report.use import LEAST_GAIN, worst_error
from mobilecal_cli.report.values import ReportData
from mobilecal_cli.report.verdict import LEVELS, Case

if TYPE_CHECKING:
    from jinja2 import Template


#: Sections behind the first screen, in order: id and title.
CONTENTS = {
    "checks": "Checks",
    "limits": "Uncertainty",
    "stations": "Stations",
    "description": "Robot description",
    "record": "Input",
}
_LEAST_PROBABILITY = 1e-6  # worth a digit


def opened_section(report: ReportData) -> str:
    """The section that shows what decides the verdict; "" for one that passes."""
    failed = (check for check in report.verdict.checks if check.outcome in LEVELS)
    return next((section_of(check) for check in failed if check.why == report.verdict.reason), "")


def report_html(report: ReportData, case: Case, snapshots: Sequence[Snapshot] = ()) -> str:
    """The report as one HTML page: no network, one script, the same bytes for the same values.

    The first screen has the verdict, the numbers and what limits them; the rest is collapsed. The script links plots
    and images by station, and draws the view in space from the report's JSON, which is in the page. It has images of
    the legs whose first station has a snapshot.
    """
    from markupsafe import Markup

    solution, extraction, worst = case.solution, case.extraction, worst_error(case.solution, case.gates)
    script, style = _asset("page.js"), _asset("page.css") + STYLE
    text = link_terms(
        template("report.html.jinja").render(
            report=report,
            plots=plots(solution, extraction),
            views=leg_views(solution, extraction, snapshots),
            thumbnails=thumbnails(solution, extraction, snapshots),
            path=path_picture(solution, extraction),
            limits=None if worst is None else budget_bar(worst),
            contents=list(CONTENTS.items()),
            opened=opened_section(report),
            stops=[stop.text for stop in report.suggestions if stop.gain >= LEAST_GAIN],
            change="" if report.change is None else _change(report.change),
            orientation=report.parameters.orientation,
            policy=f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}",
            style=Markup(style),
        )
    )
    # Nothing in the data can end its element.
    data = json_text(report).translate({ord(character): f"\\u{ord(character):04x}" for character in "<>&"})
    json_block = f'<script type="application/json" id="data">{data}</script>'
    return text.replace("<!--scripts-->", f"{json_block}\n<script>{script}</script>")


def _hash(text: str) -> str:
    """What a Content-Security-Policy allows: exactly this script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


@functools.cache
def _asset(name: str) -> str:
    return files("mobilecal_cli.report").joinpath("templates", name).read_text(encoding="utf-8")


@functools.cache
def template(name: str) -> Template:
    """A template of this package. It escapes all text and treats undefined names as errors."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def shown(value: object) -> object:
        """Escape control characters in every string that a template prints."""
        return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    environment = Environment(
        loader=PackageLoader("mobilecal_cli.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=shown,
    )
    return environment.get_template(name)


def _change(change: Change) -> str:
    in_sigma = np.isfinite(change.sigmas).any()
    more = "; in sigma: divided by the standard deviation of the difference" if in_sigma else ""
    text = f"Change: difference from {change.against}{more}."
    if change.p_value is not None:
        text += (
            " If the robot did not change, the probability of a difference this large is "
            f"{percent_text(change.p_value, _LEAST_PROBABILITY)}."
        )
    return text


class Term(NamedTuple):
    """One entry of the glossary: its anchor after "term-", heading, and the pattern of the words that link to it."""

    key: str
    name: str
    pattern: str
    definition: str


TERMS = (
    Term("contradiction", "Contradiction", "contradict(?:ions?|s)?",
         "A stated value of the robot description that the recording disagrees with by more than four standard "
         "deviations. The solver then trusts it less."),
    Term("dead-reckoning", "Dead reckoning", "dead reckoning",
         "The path of the base, computed from the wheel rotations alone."),
    Term("gimbal-lock", "Gimbal lock", "gimbal lock",
         "An orientation at which Euler angles are not unique: the middle angle is near ±90°. Use the rotation "
         "vector or the quaternion there."),
    Term("hold-out", "Hold-out", "hold-out|held-out|held out",
         "Data kept aside: it has no influence on the result, and the result is tested on it."),
    Term("leg", "Leg", "legs?", "The motion of the base from one station to the next."),
    Term("nominal", "Nominal value", "nominal (?:values?|wheels|head-eye transform)",
         "The value of a parameter before calibration, from the URDF or from rig.yaml."),
    Term("observable", "Observable", "(?:un)?observable",
         "A parameter is observable if the motion in the recording determines it. An unobservable parameter "
         "keeps its nominal value, with the standard deviation of a nominal value."),
    Term("outlier", "Outlier", "outliers?",
         "A station, leg or reading that is inconsistent with the others. The solver leaves it out."),
    Term("point-error", "Point error", "point errors?",
         "The station-to-station corner error in space, root mean square in mm. The paper's Table 1 calls it Error."),
    Term("prior", "Prior", "priors?",
         "What is known of a parameter or a constant of the robot description without the recording: a value with its "
         "standard deviation. The solver treats it as one more measurement."),
    Term("rejected", "Rejected", "rejected|rejections?",
         "A station or image is rejected before the solve if it gives no usable measurement."),
    Term("reprojection", "Reprojection error", "reprojection errors?",
         "The station-to-station corner error in the images, root mean square in px."),
    Term("residual", "Residual", "residuals?",
         "The difference between a measurement and its prediction by the solution."),
    Term("sigma", "Sigma", "standard deviations?|sigmas?",
         "Standard deviation (1 sigma): the expected size of the error. The true value is within 1 sigma in 68 % of "
         "cases and within 2 sigma in 95 %."),
    Term("station", "Station", "stations?",
         "A moment at which the cameras see the board, usually while the robot stands still."),
    Term("corner-error", "Station-to-station corner error", "station-to-station corner errors?",
         "How well the nine parameters predict the board corners of one station from those of the next."),
)  # fmt: skip

_ANY = re.compile(
    r"(?<![\w-])(?:"
    + "|".join(f"(?P<t{i}>{term.pattern})" for i, term in enumerate(TERMS)).replace(" ", r"\s+")
    + r")(?![\w-])",
    re.IGNORECASE,
)
_TAG = re.compile(r"(<[^>]*>)")
_NAME = re.compile(r"</?([a-zA-Z0-9]+)")
#: Elements whose text gets no links: code, drawings, headings, the glossary itself, and links.
_PLAIN = frozenset(
    {"style", "title", "svg", "code", "a", "h1", "h2", "h3", "th", "summary", "dl", "label", "button"}
)


def link_terms(page: str) -> str:
    """The page with the definition of each term at its first use in each section, as a tooltip.

    Args:
        page: HTML in which "<" and ">" occur in tags only.
    """
    parts = _TAG.split(page)
    linked: set[str] = set()
    plain = 0  # depth of elements that get no links
    for i, part in enumerate(parts):
        if not part.startswith("<"):
            if not plain and part.strip():
                parts[i] = _ANY.sub(lambda match: _link(match, linked), part)
            continue
        matched = _NAME.match(part)
        name = matched.group(1).lower() if matched else ""
        if name in ("section", "details"):
            linked.clear()
        elif name in _PLAIN and not part.endswith("/>"):
            plain += -1 if part.startswith("</") else 1
    return "".join(parts)


def _link(match: re.Match[str], linked: set[str]) -> str:
    term = TERMS[int((match.lastgroup or "t0")[1:])]
    if term.key in linked:
        return match.group()
    linked.add(term.key)
    return f'<abbr title="{escape(term.definition)}">{match.group()}</abbr>'
