"""Detected and predicted corners drawn over the images (paper's Fig. 6)."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import Corners, Extraction, FloatArray, Side, Snapshot, Solution
from mobilecal_cli.report.numbers import station_names

_MOST_OTHERS = 40  # keeps the page under 5 MB
_WIDTH_PX = 640  # wider regions are scaled down to keep the page small; the marks are vectors and stay sharp
_MARGIN = 0.3  # around the board, as a share of its size in the image
_QUALITY = 72


@dataclass(frozen=True, slots=True)
class Overlay:
    """One image with marks, for the page's template.

    Attributes:
        side: the camera.
        x, y, width, height: region around the board, px; the marks are in pixels of the whole image.
        jpeg: that region (scaled down) as base64, "" if the image cannot be decoded.
        marks: (u, v) detected and (u, v) predicted, one row per corner.
    """

    side: Side
    x: int
    y: int
    width: int
    height: int
    jpeg: str
    marks: list[list[float]]


@dataclass(frozen=True, slots=True)
class LegView:
    """Both images of a leg's first station.

    Attributes:
        observation: index of the first station.
        rank: "worst", "median", "best" or "only"; "" for the others, which the page shows on request.
        from_station, to_station: names of the leg's ends; the corners of `to_station` are predicted in the
            images of `from_station`.
        error_mm, error_px: point error and reprojection error of this leg.
        pictures: left and right image.
    """

    observation: int
    rank: str
    from_station: str
    to_station: str
    error_mm: float
    error_px: float
    pictures: tuple[Overlay, Overlay]


def leg_views(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot]) -> list[LegView]:
    """The worst, the median and the best leg among those whose first station has images, and up to 40 others."""
    residuals, seen = solution.residuals, extraction.observations
    pictures = {(s.log, s.station): s for s in snapshots}
    shown = [leg for leg, (i, _) in enumerate(residuals.legs) if (seen[i].log, seen[i].station) in pictures]
    order = sorted(shown, key=lambda leg: (-residuals.leg_reprojection_px[leg], leg))
    if not order:
        return []
    chosen = dict.fromkeys([order[0], order[len(order) // 2], order[-1]])
    ranks = dict(zip(chosen, _ranks(len(chosen)), strict=True))
    others = [leg for leg in shown if leg not in ranks]
    others = others[:: max(1, math.ceil(len(others) / _MOST_OTHERS))]
    names = station_names(extraction)
    views = []
    for leg in (*ranks, *others):
        i, j = residuals.legs[leg]
        snapshot = pictures[seen[i].log, seen[i].station]
        views.append(
            LegView(
                observation=int(i),
                rank=ranks.get(leg, ""),
                from_station=names[i],
                to_station=names[j],
                error_mm=float(residuals.leg_point_rms_m[leg] * 1e3),
                error_px=float(residuals.leg_reprojection_px[leg]),
                pictures=(
                    _overlay("left", snapshot.left_jpeg, seen[i].left, residuals.predicted_left_px[leg]),
                    _overlay("right", snapshot.right_jpeg, seen[i].right, residuals.predicted_right_px[leg]),
                ),
            )
        )
    return views


def _ranks(count: int) -> tuple[str, ...]:
    return {1: ("only",), 2: ("worst", "best")}.get(count, ("worst", "median", "best"))


def _overlay(side: Side, jpeg: bytes, corners: Corners, predicted: FloatArray) -> Overlay:
    import cv2

    detected, predicted = corners.pixels[corners.seen], predicted[corners.seen]
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE) if jpeg else None
    marks = np.concatenate([detected, predicted], axis=1) + 0.5  # SVG coordinates start at a pixel's edge
    shown = detected if len(detected) else corners.pixels  # where the board is, as the other camera sees it
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = _MARGIN * float(np.max(high - low)) + 8
    bounds = np.array([[0, 0], [1 << 20, 1 << 20]] if picture is None else [[0, 0], picture.shape[::-1]])
    (x, y), (right, bottom) = np.clip([low - margin, high + margin], *bounds).astype(int).tolist()
    place = (side, x, y, right - x, bottom - y)
    if picture is None:
        return Overlay(*place, "", np.round(marks, 2).tolist())
    part = picture[y:bottom, x:right]
    if part.shape[1] > _WIDTH_PX:
        size = (_WIDTH_PX, max(1, round(part.shape[0] * _WIDTH_PX / part.shape[1])))
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    encoded = cv2.imencode(".jpg", part, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return Overlay(*place, base64.b64encode(encoded.tobytes()).decode("ascii"), np.round(marks, 2).tolist())
