"""Detected and carried corners drawn over the real pictures (paper's Fig. 6)."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import Extraction, FloatArray, Side, Snapshot, Solution
from mobilecal_cli.report.numbers import station_names

_WIDTH_PX = 800  # wider pictures are shrunk: the page stays small, and the marks are drawn in vectors anyway
_QUALITY = 72


@dataclass(frozen=True, slots=True)
class Overlay:
    """One picture with marks, as the page's template draws it.

    Attributes:
        side: which camera.
        width, height: of the original picture, px; the marks are in its pixels.
        jpeg: the (shrunk) picture as base64, "" when it cannot be decoded.
        marks: (u, v) detected and (u, v) carried, one row a corner.
    """

    side: Side
    width: int
    height: int
    jpeg: str
    marks: list[list[float]]


@dataclass(frozen=True, slots=True)
class LegView:
    """Both pictures of a leg's first station.

    Attributes:
        rank: "worst", "median" or "best".
        from_station, to_station: names of the leg's ends; the corners of `to_station` are carried into the
            pictures of `from_station`.
        error_mm, error_px: of this leg.
        pictures: left and right.
    """

    rank: str
    from_station: str
    to_station: str
    error_mm: float
    error_px: float
    pictures: tuple[Overlay, Overlay]


def leg_views(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot]) -> list[LegView]:
    """The worst, the median and the best leg among those whose first station has pictures."""
    residuals, seen = solution.residuals, extraction.observations
    pictures = {(s.log, s.station): s for s in snapshots}
    shown = [leg for leg, (i, _) in enumerate(residuals.legs) if (seen[i].log, seen[i].station) in pictures]
    order = sorted(shown, key=lambda leg: (-residuals.leg_reprojection_px[leg], leg))
    if not order:
        return []
    chosen = dict.fromkeys([order[0], order[len(order) // 2], order[-1]])
    names = station_names(extraction)
    views = []
    for rank, leg in zip(_ranks(len(chosen)), chosen, strict=True):
        i, j = residuals.legs[leg]
        snapshot = pictures[seen[i].log, seen[i].station]
        views.append(
            LegView(
                rank=rank,
                from_station=names[i],
                to_station=names[j],
                error_mm=float(residuals.leg_point_rms_m[leg] * 1e3),
                error_px=float(residuals.leg_reprojection_px[leg]),
                pictures=(
                    _overlay(
                        "left", snapshot.left_jpeg, seen[i].left.pixels, residuals.predicted_left_px[leg]
                    ),
                    _overlay(
                        "right", snapshot.right_jpeg, seen[i].right.pixels, residuals.predicted_right_px[leg]
                    ),
                ),
            )
        )
    return views


def _ranks(count: int) -> tuple[str, ...]:
    return {1: ("only",), 2: ("worst", "best")}.get(count, ("worst", "median", "best"))


def _overlay(side: Side, jpeg: bytes, detected: FloatArray, carried: FloatArray) -> Overlay:
    import cv2

    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE) if jpeg else None
    marks = np.round(
        np.concatenate([detected, carried], axis=1) + 0.5, 2
    ).tolist()  # SVG's 0 is a pixel's edge
    if picture is None:
        reach = np.ceil(np.max(detected, axis=0) + 20).astype(int)
        return Overlay(side, int(reach[0]), int(reach[1]), "", marks)
    height, width = picture.shape
    if width > _WIDTH_PX:
        size = (_WIDTH_PX, max(1, round(height * _WIDTH_PX / width)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return Overlay(side, width, height, base64.b64encode(encoded.tobytes()).decode("ascii"), marks)
