"""report.html: one file that opens without a network and says whether to trust the numbers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from mobilecal_cli import se3
from mobilecal_cli.model import NINE, Evaluation, Extraction, Provenance, Setting, Snapshot, Solution
from mobilecal_cli.report import overlays
from mobilecal_cli.report.changes import Change, change_rows
from mobilecal_cli.report.data import coverage
from mobilecal_cli.report.drawn import Figures, draw_figures
from mobilecal_cli.report.evaluation import drift_rows, evaluation_rows
from mobilecal_cli.report.findings import (
    LEVEL_NAMES,
    evidence_rows,
    extra_rows,
    jackknife_sentence,
    log_rows,
    predicted_rows,
    scale_sentence,
    suggestion_sentences,
)
from mobilecal_cli.report.numbers import (
    NEAR_LOCK_DEG,
    QUANTITIES,
    board_distance_m,
    nine_numbers,
    nine_std,
    predicted_point_rms_m,
    reference_frame,
    reference_pose,
    rejected_station,
    rejection_counts,
    sigmas,
    stations_looked_at,
    written,
)
from mobilecal_cli.report.pages import environment
from mobilecal_cli.report.verdict import MIN_STATIONS, Verdict

if TYPE_CHECKING:
    from jinja2 import Template

_MOST_REJECTIONS = 200  # details of more than these are in report.json only
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def report_html(
    solution: Solution,
    extraction: Extraction,
    snapshots: Sequence[Snapshot],
    provenance: Provenance,
    verdict: Verdict,
    trial: Evaluation | None = None,
    change: Change | None = None,
    figures: Callable[[], Figures] | None = None,
) -> str:
    """The report as one HTML page: no scripts, no network, the same bytes for the same values.

    Args:
        solution: the answer.
        extraction: what it was solved from.
        snapshots: pictures of some or all stations, for the overlays; may be empty.
        provenance: when, by which version, from which logs and settings.
        verdict: what `judge` says.
        trial: the calibration tried on what was held out, if anything was.
        change: against the last calibration or the drawing, if there is either.
        figures: gives what `draw_figures` draws, if that is being done elsewhere; asked last.
    """
    from markupsafe import Markup  # SVG made here; matplotlib has escaped every text in it

    rig = extraction.rig
    template = _template()
    page: dict[str, Any] = {
        "verdict": verdict,
        "checks": verdict.checks,
        "numbers": _table_one(solution, extraction),
        "refined": solution.refinement is not None,
        "method": solution.method,
        "head_frame": rig.chain.head_frame,
        "camera_frame": reference_frame(rig.cameras),
        "camera_side": rig.cameras.reference,
        "rectified": rig.cameras.rectified,
        "near_lock_deg": NEAR_LOCK_DEG,
        "lock_deg": se3.gimbal_margin_deg(reference_pose(solution.parameters, rig.cameras)[:3, :3]),
        "quaternion": se3.quaternion_xyzw(reference_pose(solution.parameters, rig.cameras)[:3, :3]).tolist(),
        "linear": solution.linear,
        "sigmas": [(s.name, s.meaning, written(s), s.unit) for s in sigmas(solution, rig.cameras)],
        "noise": solution.uncertainty.noise if solution.uncertainty is not None else None,
        "level_names": LEVEL_NAMES,
        "outliers": solution.outliers,
        "predicted": predicted_rows(solution),
        "jackknife": jackknife_sentence(solution),
        "extras": extra_rows(solution, extraction),
        "evidence": evidence_rows(solution, extraction),
        "scale": scale_sentence(solution.scale) if solution.scale is not None else "",
        "logs_apart": log_rows(solution, extraction),
        "nine": NINE,
        "change": change,
        "changes": change_rows(change),
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
        "looked_at": stations_looked_at(extraction),
        "least_stations": MIN_STATIONS,
        "coverage": coverage(extraction),
        "leg_views": overlays.leg_views(solution, extraction, snapshots),
        "rejection_counts": rejection_counts(extraction),
        "rejections": [
            (item.reason, item.detail, rejected_station(item, extraction), _moment(item.time_ns))
            for item in extraction.rejections[:_MOST_REJECTIONS]
        ],
        "rejections_hidden": max(0, len(extraction.rejections) - _MOST_REJECTIONS),
        "notes": extraction.notes,
        "motion": solution.motion,
        "counts": extraction.counts,
        "board": extraction.board,
        "sources": rig.sources,
        "settled_by": rig.settled_by,
        "settings": list(_flat(provenance.config)),
        "provenance": provenance,
    }
    drawn = figures() if figures is not None else draw_figures(solution, extraction)
    return template.render(
        page,
        figures={name: Markup(text) for name, text in drawn.named.items()},
        paths=[(path, Markup(above), Markup(time)) for path, above, time in drawn.paths],
    )


@functools.cache
def _template() -> Template:
    return environment().get_template("report.html.jinja")


def _table_one(solution: Solution, extraction: Extraction) -> list[dict[str, Any]]:
    cameras = extraction.rig.cameras
    final = nine_numbers(solution.parameters, cameras)
    std = nine_std(solution, cameras) or (None,) * len(QUANTITIES)
    linear = nine_numbers(solution.linear.parameters, cameras)
    return [
        {
            "symbol": quantity.symbol,
            "meaning": quantity.meaning,
            "unit": quantity.unit,
            "linear": f"{before:.{quantity.digits}f}",
            "final": f"{after:.{quantity.digits}f}",
            "std": "" if s is None else f"± {s:.{quantity.digits}f}",
        }
        for quantity, before, after, s in zip(QUANTITIES, linear, final, std, strict=True)
    ]


def _moment(time_ns: int) -> str:
    """A log's time as UTC; seconds where it is no date that a calendar holds."""
    if 0 < time_ns < 253_402_300_800_000_000_000:
        return (_EPOCH + timedelta(microseconds=time_ns // 1000)).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
    return f"{time_ns / 1e9:.3f} s"


def _flat(config: Mapping[str, Setting], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as (dotted key, value)."""
    for key, value in config.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", "none" if value is None else str(value)
