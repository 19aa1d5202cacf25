"""From the board in the pictures of a station to one observation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mobilecal_cli.model import Board, Corners, FloatArray, Observation, Rejection, Station, StereoRig
from mobilecal_cli.vision.grid import fit_grid, turned, turns
from mobilecal_cli.vision.pose import absolute_orientation, board_pose, square_from_points
from mobilecal_cli.vision.stereo import triangulate
from mobilecal_cli.vision.values import Detection, Miss, StereoPoints

_MAX_DRIFT_PX = 0.5
_DRIFT_SIGMAS = 4.0
_MAX_EPIPOLAR_RMS_PX = (
    1.5  # rows of the two pictures about 4 px apart: the stereo calibration is not this rig's
)
_MAX_REPROJECTION_PX = 3.0
_SQUARE_TOLERANCE = 0.1
_SQUARE_SIGMAS = 5.0
_FLOOR_PX = 0.003  # what the corner model itself leaves on pictures without noise


def _by_reason(misses: Sequence[Miss]) -> str:
    counts = Counter(miss.reason for miss in misses).most_common()
    first = {miss.reason: miss.detail for miss in reversed(misses)}
    return "; ".join(f"{count} x {reason} ({first[reason]})" for reason, count in counts)


def _no_pair(left: Sequence[Detection | Miss], right: Sequence[Detection | Miss]) -> tuple[str, str]:
    """Reason and detail for a station of which no shot shows the board in both pictures."""
    misses = {
        side: [item for item in items if isinstance(item, Miss)]
        for side, items in (("left", left), ("right", right))
    }
    every = [*misses["left"], *misses["right"]]
    if not every:
        return "no shots", "the station has no stereo pairs"
    sides = [f"{side}: {_by_reason(items)}" for side, items in misses.items() if items]
    detail = f"{len(left)} shots; " + "; ".join(sides)
    return Counter(miss.reason for miss in every).most_common(1)[0][0], detail


def _same_numbering(shots: Sequence[FloatArray], board: Board) -> FloatArray:
    """(M, 2) corners of each shot in the numbering nearest to the first shot's: (n, M, 2)."""
    aligned = []
    for pixels in shots:
        options = [turned(pixels, board.columns, board.rows, k) for k in turns(board.columns, board.rows)]
        aligned.append(min(options, key=lambda p: float(np.sum((p - shots[0]) ** 2))))
    return np.stack(aligned)


def _average(shots: FloatArray, board: Board) -> Corners:
    """Corners averaged over the shots, (n, M, 2), with the noise of the average.

    The noise is the scatter over the shots, pooled over the corners, divided by sqrt(n); but no less than what
    the average's own roughness shows: errors of refinement that are the same in every shot do not average out.
    """
    mean = shots.mean(axis=0)
    sigma_px = max(fit_grid(mean.reshape(board.rows, board.columns, 2)).sigma_px, _FLOOR_PX)
    n = len(shots)
    if n > 1:
        scatter = np.sqrt(np.sum((shots - mean) ** 2) / (mean.size * (n - 1)))
        sigma_px = max(sigma_px, float(scatter / np.sqrt(n)))
    return Corners(mean, sigma_px, n)


def _drift_px(shots: FloatArray) -> FloatArray:
    """How far each shot's corners lie from the middle of all shots, rms per coordinate: (n, M, 2) → (n,)."""
    drift: FloatArray = np.sqrt(np.mean((shots - np.median(shots, axis=0)) ** 2, axis=(1, 2)))
    return drift


def _best_fit(
    rig: StereoRig, left: Corners, right: Corners, board: Board
) -> tuple[StereoPoints | Miss, FloatArray]:
    """Triangulated points with the right picture numbered so that it fits the left one best."""
    options = [turned(right.pixels, board.columns, board.rows, k) for k in turns(board.columns, board.rows)]
    fits = [triangulate(rig, left.pixels, option, left.sigma_px, right.sigma_px) for option in options]
    best = min(
        range(len(fits)), key=lambda i: fit.rms_px if isinstance(fit := fits[i], StereoPoints) else np.inf
    )
    return fits[best], options[best]


def observe(
    log: int,
    station: Station,
    left: Sequence[Detection | Miss],
    right: Sequence[Detection | Miss],
    rig: StereoRig,
    board: Board,
    square_m: float | None,
) -> Observation | Rejection:
    """One observation from what was seen in the pictures of a station.

    Args:
        log: index of the recording.
        station: when, and the joint readings.
        left, right: what was found in the pictures of each shot, in the order of `station.shots`.
        rig: the stereo pair.
        board: the board's counts.
        square_m: side of a square, m; None: this station's own estimate is used.

    Returns:
        The observation, or why the station gives none. `Observation.square_m` is the station's own estimate
        in either case.
    """

    def rejected(reason: str, detail: str) -> Rejection:
        return Rejection("vision", reason, detail, station.time_ns, station.index, log)

    pairs = [
        (a, b)
        for a, b in zip(left, right, strict=True)
        if isinstance(a, Detection) and isinstance(b, Detection)
    ]
    if not pairs:
        return rejected(*_no_pair(left, right))
    shots_left = _same_numbering([a.pixels for a, _ in pairs], board)
    shots_right = _same_numbering([b.pixels for _, b in pairs], board)
    drift_px = np.maximum(_drift_px(shots_left), _drift_px(shots_right))
    claimed_px = float(np.median([max(a.sigma_px, b.sigma_px) for a, b in pairs]))
    limit_px = max(_MAX_DRIFT_PX, _DRIFT_SIGMAS * claimed_px)
    still = drift_px <= limit_px
    if 2 * np.sum(still) <= len(pairs):
        return rejected(
            "board or robot moved during the rest",
            f"corners drift by up to {drift_px.max():.2f} px over {len(pairs)} shots, limit {limit_px:.2f} px",
        )
    corners_left, corners_right = _average(shots_left[still], board), _average(shots_right[still], board)
    points, pixels_right = _best_fit(rig, corners_left, corners_right, board)
    if isinstance(points, Miss):
        return rejected(points.reason, points.detail)
    if points.rms_px > _MAX_EPIPOLAR_RMS_PX:
        return rejected(
            "left and right do not fit together",
            f"corners are {points.rms_px:.2f} px rms off the epipolar lines, limit {_MAX_EPIPOLAR_RMS_PX} px",
        )
    corners_right = Corners(pixels_right, corners_right.sigma_px, corners_right.pictures)
    grid = board.grid()
    pictures = corners_left.pixels, corners_right.pixels, corners_left.sigma_px, corners_right.sigma_px
    rough_m = square_from_points(points.points_c, board.columns, board.rows)
    start = absolute_orientation(points.points_c, rough_m * grid)
    pose = board_pose(rig, rough_m * grid, *pictures, start, free_scale=True)
    seen_m = rough_m * pose.scale
    if square_m is not None:
        tolerance_m = max(_SQUARE_TOLERANCE * square_m, _SQUARE_SIGMAS * rough_m * pose.scale_sigma)
        if abs(seen_m - square_m) > tolerance_m:
            return rejected(
                "squares of another size",
                f"triangulated squares are {1e3 * seen_m:.1f} mm wide, {1e3 * square_m:.1f} mm are said to be",
            )
        start = absolute_orientation(points.points_c, square_m * grid)
        pose = board_pose(rig, square_m * grid, *pictures, start)
    if pose.rms_px > _MAX_REPROJECTION_PX:
        return rejected(
            "left and right do not fit together",
            f"a flat board explains the corners to {pose.rms_px:.2f} px rms only, limit {_MAX_REPROJECTION_PX} px",
        )
    return Observation(
        log=log,
        station=station.index,
        time_ns=station.time_ns,
        at_rest=station.at_rest,
        joints=station.joints,
        joints_std=station.joints_std,
        left=corners_left,
        right=corners_right,
        points_c=points.points_c,
        points_cov=points.points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        square_m=seen_m,
        reprojection_px=pose.rms_px,
    )
