"""report.html: the report as one file that needs no network; without scripts, texts, tables and plots are there."""

from __future__ import annotations

import base64
import functools
import hashlib
from importlib.resources import files
from typing import TYPE_CHECKING

from mobilecal_cli.report.checks.recording import MIN_STATIONS
from mobilecal_cli.report.drawn import Drawings
from mobilecal_cli.report.glossary import TERMS, link_terms
from mobilecal_cli.report.pages import environment
from mobilecal_cli.report.svg import STYLE
from mobilecal_cli.report.values import ReportData, json_text
from mobilecal_cli.report.wording.page import leg_title, page_words

if TYPE_CHECKING:
    from jinja2 import Template


def report_html(report: ReportData, drawings: Drawings) -> str:
    """The report as one HTML page: no network, one script, the same bytes for the same values.

    The script links plots, tables and images by station, and draws the view in space from the report's JSON, which is
    in the page.
    """
    from markupsafe import Markup, escape  # SVG made here, with every text escaped

    script, style = _asset("page.js"), _asset("page.css") + STYLE
    filled: dict[str, object] = {
        side: f"{100 * share:.0f} %" for side, share in report.image_coverage.items()
    }
    said = page_words(report)
    filled |= {"linear": report.linear, "refinement": said["refinement"]}
    figures = [
        {
            "section": figure.section,
            "half": figure.half,
            "parts": [(title, Markup(svg)) for title, svg in figure.parts],
            "caption": Markup(
                escape(figure.caption.format(**filled)).replace("Good:", Markup("<strong>Good:</strong>"))
            ),
        }
        for figure in drawings.figures
    ]
    text = link_terms(
        _template().render(
            report=report,
            figures=figures,
            views=drawings.views,
            said=said,
            leg_title=leg_title,
            least_stations=MIN_STATIONS,
            terms=TERMS,
            policy=f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}",
            style=Markup(style),
        )
    )
    data = json_text(report)
    for character in "<>&":  # nothing in the data can end its element
        data = data.replace(character, f"\\u{ord(character):04x}")
    json_block = f'<script type="application/json" id="data">{data}</script>'
    return text.replace("<!--scripts-->", f"{json_block}\n<script>{script}</script>")


def _hash(text: str) -> str:
    """What a Content-Security-Policy allows: exactly this script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


@functools.cache
def _asset(name: str) -> str:
    return files("mobilecal_cli.report").joinpath("templates", name).read_text(encoding="utf-8")


@functools.cache
def _template() -> Template:
    return environment().get_template("report.html.jinja")
