"""report.html: the report as one file that needs no network and no scripts."""

from __future__ import annotations

import base64
import functools
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import Evaluation, Extraction, Provenance, Setting, Snapshot, Solution
from mobilecal_cli.report import overlays
from mobilecal_cli.report.at_work import recommendation
from mobilecal_cli.report.changes import Change, change_rows
from mobilecal_cli.report.check import OUTCOME_LABELS
from mobilecal_cli.report.checks.recording import MIN_STATIONS
from mobilecal_cli.report.contradictions import constant_groups, contradiction_sentences
from mobilecal_cli.report.data import coverage, report_json, square_mm
from mobilecal_cli.report.decomposition import reprojection_sentence
from mobilecal_cli.report.drawn import draw_figures
from mobilecal_cli.report.evaluation import drift_rows, evaluation_rows
from mobilecal_cli.report.findings import (
    jackknife_sentence,
    scale_sentence,
    suggestion_sentences,
)
from mobilecal_cli.report.glossary import TERMS, link_terms
from mobilecal_cli.report.numbers import (
    QUANTITIES,
    Rotation,
    board_distance_m,
    nine_numbers,
    predicted_point_rms_m,
    reference_frame,
    reference_pose,
    rejected_station,
    rejection_counts,
    rotation_of,
    sigmas,
    stations_looked_at,
    std_text,
    written,
)
from mobilecal_cli.report.outliers import outlier_sentences
from mobilecal_cli.report.pages import environment
from mobilecal_cli.report.svg import STYLE
from mobilecal_cli.report.tables import tables
from mobilecal_cli.report.units import value_text
from mobilecal_cli.report.verdict import Verdict
from mobilecal_cli.report.wording import words

if TYPE_CHECKING:
    from jinja2 import Template

_MOST_REJECTIONS = 200  # further ones are in report.json only
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def report_html(
    solution: Solution,
    extraction: Extraction,
    snapshots: Sequence[Snapshot],
    provenance: Provenance,
    verdict: Verdict,
    trial: Evaluation | None = None,
    change: Change | None = None,
) -> str:
    """The report as one HTML page: no network, one script, the same bytes for the same values.

    Without scripts and on paper all texts, tables and plots are there; the script links them by station and draws the
    view in space from the report's JSON, which is in the page.

    Args:
        solution: the answer.
        extraction: what it was solved from.
        snapshots: images of some or all stations for the overlays; may be empty.
        provenance: time, version, recordings and settings.
        verdict: result of `judge`.
        trial: evaluation on the held-out stations, if any.
        change: difference from the last calibration or from the nominal values, if there is either.
    """
    from markupsafe import Markup  # SVG made here, with every text escaped

    rig, rotation = extraction.rig, rotation_of(solution)
    template = _template()
    page: dict[str, Any] = {
        "verdict": verdict,
        "checks": [(check, words(check)) for check in verdict.checks],
        "passed": sum(check.outcome == "good" for check in verdict.checks),
        "numbers": _table_one(solution, extraction, rotation),
        "refined": solution.refinement is not None,
        "method": solution.method,
        "head_frame": rig.chain.head_frame,
        "camera_frame": reference_frame(solution.cameras),
        "camera_side": solution.cameras.reference,
        "rectified": solution.cameras.rectified,
        "rotation": rotation,
        "euler": _euler(rotation),
        "linear": solution.linear,
        "sigmas": [(s.name, s.meaning, written(s), s.unit) for s in sigmas(solution)],
        "outliers": tuple(outlier_sentences(solution.outliers, extraction)),
        "jackknife": jackknife_sentence(solution),
        "constant_groups": constant_groups(solution, extraction),
        "contradictions": [contradiction_sentences(found, solution) for found in solution.contradictions],
        "limiting": recommendation(solution),
        "reprojection_parts": reprojection_sentence(solution, extraction),
        "scale": scale_sentence(solution.scale) if solution.scale is not None else "",
        "tables": tables(solution, extraction),
        "change": change,
        "changes": change_rows(change, [s.value for s in sigmas(solution)]),
        "change_in_sigma": change is not None and bool(np.isfinite(change.sigmas).any()),
        "change_in_percent": change is not None and bool(np.isfinite(change.percent).any()),
        "trial": trial,
        "trial_rows": evaluation_rows(trial) if trial is not None else (),
        "drift_rows": drift_rows(trial) if trial is not None else (),
        "suggestions": suggestion_sentences(solution, extraction),
        "error_mm": solution.point_rms_m * 1e3,
        "linear_error_mm": solution.linear.point_rms_m * 1e3,
        "predicted_mm": predicted_point_rms_m(extraction, solution) * 1e3,
        "reprojection_px": solution.reprojection_rms_px,
        "distance_m": board_distance_m(extraction),
        "stations": len(extraction.observations),
        "stations_found": stations_looked_at(extraction),
        "least_stations": MIN_STATIONS,
        "coverage": coverage(extraction),
        "leg_views": overlays.leg_views(solution, extraction, snapshots),
        "rejection_counts": rejection_counts(extraction),
        "rejections": [
            (item.reason, item.detail, rejected_station(item, extraction), _moment(item.time_ns))
            for item in extraction.rejections[:_MOST_REJECTIONS]
        ],
        "rejections_more": max(0, len(extraction.rejections) - _MOST_REJECTIONS),
        "notes": extraction.notes,
        "motion": solution.motion,
        "counts": extraction.counts,
        "board": extraction.board,
        "square_mm": square_mm(extraction),
        "sources": rig.sources,
        "settled_by": rig.settled_by,
        "settings": list(_flat({k: v for k, v in provenance.config.items() if k != "setting_sources"})),
        "provenance": provenance,
        "outcomes": OUTCOME_LABELS,
        "terms": TERMS,
    }
    drawn, script, style = draw_figures(solution, extraction), _asset("page.js"), _asset("page.css") + STYLE
    text = link_terms(
        template.render(
            page,
            figures={name: Markup(text) for name, text in drawn.named.items()},
            paths=[(path, Markup(above), Markup(time)) for path, above, time in drawn.paths],
            policy=f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}",
            style=Markup(style),
        )
    )
    data = report_json(solution, extraction, provenance, verdict, trial, change)
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


def _table_one(solution: Solution, extraction: Extraction, rotation: Rotation) -> list[dict[str, Any]]:
    """Rows of the nine parameters: rotation vector, translation, wheels; in deg and mm."""
    cameras = solution.cameras
    std: list[float | None] = [s.value for s in sigmas(solution)] or [None] * 9
    unknown = ["fixed" if s is None else "–" for s in std]  # "–": another part of the rotation is fixed
    std[:3] = [None] * 3 if rotation.vector_std_deg is None else rotation.vector_std_deg.tolist()
    linear_R = reference_pose(solution.linear.parameters, cameras)[:3, :3]
    linear = [*np.degrees(se3.log_so3(linear_R)), *nine_numbers(solution.linear.parameters, cameras)[3:]]
    final = [*rotation.vector_deg, *nine_numbers(solution.parameters, cameras)[3:]]
    labels = [f"{name}, {axis}" for name in ("rotation vector", "camera position") for axis in "xyz"]
    labels += [quantity.meaning for quantity in QUANTITIES[6:]]
    return [
        {
            "meaning": meaning,
            "unit": quantity.unit,
            "linear": value_text(before, s, quantity.digits),
            "final": value_text(after, s, quantity.digits),
            "std": instead if s is None else std_text(s),
        }
        for meaning, quantity, before, after, s, instead in zip(
            labels, QUANTITIES, linear, final, std, unknown, strict=True
        )
    ]


def _euler(rotation: Rotation) -> list[tuple[str, str]]:
    """Euler angles x, y, z with their standard deviations, deg, "" where unknown; empty near gimbal lock."""
    if rotation.euler_deg is None:
        return []
    stds = [None] * 3 if rotation.euler_std_deg is None else rotation.euler_std_deg.tolist()
    return [
        (value_text(angle, std, 3), "" if std is None else std_text(std))
        for angle, std in zip(rotation.euler_deg.tolist(), stds, strict=True)
    ]


def _moment(time_ns: int) -> str:
    """A recording's time as a UTC date, or in seconds if it is not a valid date."""
    if 0 < time_ns < 253_402_300_800_000_000_000:
        return (_EPOCH + timedelta(microseconds=time_ns // 1000)).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
    return f"{time_ns / 1e9:.3f} s"


def _flat(value: Setting, key: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as (dotted key, value as YAML writes it)."""
    if isinstance(value, Mapping) and value:
        for name, item in value.items():
            yield from _flat(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for number, item in enumerate(value):
            yield from _flat(item, f"{key}[{number}]")
    else:
        yield key, _yaml(value)


def _yaml(value: object) -> str:
    """A value in YAML's flow style; strings and paths without quotes."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, list | tuple | set | frozenset):
        return f"[{', '.join(_yaml(item) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{name}: {_yaml(item)}' for name, item in value.items())}}}"
    return str(value)
