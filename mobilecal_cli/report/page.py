"""report.html: the report as one file that needs no network; without scripts, texts, tables and plots are there.

templates/terms.html explains the words; docs/reference/glossary.md defines the same terms.
"""

from __future__ import annotations

import base64
import functools
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

from mobilecal_cli.model.observations import Snapshot
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.plots import SHOWN_LEGS, budget_bar, leg_views, path_picture, plots, thumbnails
from mobilecal_cli.report.svg import STYLE
from mobilecal_cli.report.use import LEAST_GAIN, worst_error
from mobilecal_cli.report.values import ReportData

if TYPE_CHECKING:
    from jinja2 import Template


#: Sections behind the first screen, in order: id and title.
CONTENTS = {
    "checks": "Checks",
    "limits": "Uncertainty",
    "stations": "Stations",
    "description": "Robot description",
    "record": "Input",
    "terms": "Terms",
}


#: Level of a verdict, outcome of a check or another tag, in small letters → its style; all others are failures.
_STYLES = {"pass": "pass", "not enough": "short", "warning": "short", "outlier": "short"}


def style_of(label: str) -> str:
    """Style of a level of a verdict, an outcome or a tag: "pass", "short" or "fail"."""
    return _STYLES.get(label.lower(), "fail")


def report_html(report: ReportData, case: Case, snapshots: Sequence[Snapshot] = ()) -> str:
    """The report as one HTML page: no network, one script, the same bytes for the same values.

    The first screen has the verdict, the numbers and what limits them; the rest is collapsed, but the section of the
    criterion that decides. The script links plots and images by station, and draws the view in space from the report's
    JSON, which is in the page. It has images of the legs whose first station has a snapshot.
    """
    from markupsafe import Markup

    solution, extraction, worst = case.solution, case.extraction, worst_error(case.solution, case.gates)
    decisive = next((check for check in report.verdict.checks if not check.met), None)
    script, style = _asset("page.js"), _asset("page.css") + STYLE
    text = template("report.html.jinja").render(
        report=report,
        plots=plots(solution, extraction),
        views=leg_views(solution, extraction, snapshots),
        shown_legs=SHOWN_LEGS,
        thumbnails=thumbnails(solution, extraction, snapshots),
        path=path_picture(solution, extraction),
        limits=None if worst is None else budget_bar(worst),
        contents=list(CONTENTS.items()),
        opened="" if decisive is None else decisive.section,
        stops=[stop.text for stop in report.suggestions if stop.gain >= LEAST_GAIN],
        policy=f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}",
        style=Markup(style),
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
    environment.filters["style"] = style_of
    return environment.get_template(name)
