"""One observation per station: triangulated corners and the board's pose from all images of the station."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import (
    Board,
    Corners,
    FloatArray,
    Observation,
    Rejection,
    Station,
    StereoRig,
)
from mobilecal_cli.vision.averaging import StationCorners, turned_board, turns_of
from mobilecal_cli.vision.pose import absolute_orientation, board_pose, square_from_points
from mobilecal_cli.vision.stereo import reproject, triangulate
from mobilecal_cli.vision.values import FLOOR_PX, BoardPose, Detection, Miss, Reason, StereoPoints

_MAX_DRIFT_PX = 0.5
_DRIFT_SIGMAS = 4.0
#: Largest acceptable difference of a square's measured side from the stated one, as a share.
SQUARE_TOLERANCE = 0.1
_SQUARE_SIGMAS = 5.0
#: Reason of stations whose two images contradict each other.
INCONSISTENT: Reason = "left and right images inconsistent"
_LEAST_IN_BOTH = 8  # for boards with markers, which may be partly visible


def _by_reason(misses: Sequence[Miss]) -> str:
    counts = Counter(miss.reason for miss in misses).most_common()
    first = {miss.reason: miss.detail for miss in reversed(misses)}
    return "; ".join(f"{count} x {reason} ({first[reason]})" for reason, count in counts)


def _no_pair(left: Sequence[Detection | Miss], right: Sequence[Detection | Miss]) -> tuple[str, str]:
    """Reason and detail for a station without a stereo pair that shows the board in both images."""
    misses = {
        side: [item for item in items if isinstance(item, Miss)]
        for side, items in (("left", left), ("right", right))
    }
    every = [*misses["left"], *misses["right"]]
    if not every:
        return "no stereo pairs", "the station has no stereo pairs"
    sides = [f"{side}: {_by_reason(items)}" for side, items in misses.items() if items]
    detail = f"{len(left)} stereo pairs; " + "; ".join(sides)
    return Counter(miss.reason for miss in every).most_common(1)[0][0], detail


def _best_fit(
    rig: StereoRig, left: Corners, right: Corners, board: Board
) -> tuple[StereoPoints | Miss, Corners]:
    """Triangulate the corners that both cameras see, after renumbering the right image to match the left.

    The numbering that fits best is used. The rows of any other are several squares apart.
    """
    both = left.seen & right.seen
    fits = []
    for k in turns_of(board):
        option = replace(
            right,
            pixels=turned_board(right.pixels, board, k),
            relative_cov=turned_board(right.relative_cov, board, k),
        )
        fit = triangulate(
            rig, left.pixels[both], option.pixels[both], left.cov_px2[both], option.cov_px2[both]
        )
        fits.append((fit, option))
    return min(fits, key=lambda one: one[0].rms_px if isinstance(one[0], StereoPoints) else np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class _Whole:
    """All corners of the board: detected ones, and the others predicted from the board's pose."""

    left: Corners
    right: Corners
    points_c: FloatArray
    points_cov: FloatArray


def _completed(
    rig: StereoRig, pose: BoardPose, points_k: FloatArray, points: StereoPoints, left: Corners, right: Corners
) -> _Whole:
    both = left.seen & right.seen
    if both.all():
        return _Whole(left, right, points.points_c, points.points_cov)
    points_c = points_k @ pose.T_c_k[:3, :3].T + pose.T_c_k[:3, 3]
    moves = np.concatenate([-se3.skew(points_c), np.broadcast_to(np.eye(3), (len(points_c), 3, 3))], axis=-1)
    points_cov = moves @ pose.T_c_k_cov @ np.swapaxes(moves, -1, -2)
    expected, _ = reproject(rig, points_c)
    points_c[both], points_cov[both] = points.points_c, points.points_cov
    return _Whole(
        replace(left, pixels=np.where(left.seen[:, None], left.pixels, expected[:, :2])),
        replace(right, pixels=np.where(right.seen[:, None], right.pixels, expected[:, 2:])),
        points_c,
        points_cov,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The board at one station, with the square size given by the stereo baseline.

    Attributes:
        log, station: index of the recording, and the station.
        rig, board: the cameras, and the board to detect.
        left, right: all corners in each image; some may not be detected.
        points: triangulated corners that both cameras see.
        pose: of the board, with free scale; it is fitted to unit squares times `rough_m`.
        rough_m: initial estimate of a square's side, m.
    """

    log: int
    station: Station
    rig: StereoRig
    board: Board
    left: Corners
    right: Corners
    points: StereoPoints
    pose: BoardPose
    rough_m: float

    @property
    def square_m(self) -> float:
        """Side of a square as measured at this station, m."""
        return self.rough_m * self.pose.scale

    def rejected(self, reason: str, detail: str) -> Rejection:
        """Rejection of this station."""
        return Rejection("vision", reason, detail, self.station.time_ns, self.station.index, self.log)


def _seen_by_both(left: Corners, right: Corners) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pixels, (M, 2) px, and covariances, (M, 2, 2) px^2, of corners that both cameras see."""
    both = left.seen & right.seen
    return left.pixels[both], right.pixels[both], left.cov_px2[both], right.cov_px2[both]


def measure(
    log: int,
    station: Station,
    left: Sequence[Detection | Miss],
    right: Sequence[Detection | Miss],
    rig: StereoRig,
    board: Board,
) -> Measured | Rejection:
    """Average and triangulate the corners of a station.

    Args:
        log: index of the recording.
        station: its stereo pairs and joint readings.
        left, right: detections in the images of each stereo pair, in the order of `station.pairs`.
        rig: the stereo pair of cameras.
        board: the board's size.

    Returns:
        The board at this station, or a rejection.
    """

    def rejected(reason: str, detail: str) -> Rejection:
        return Rejection("vision", reason, detail, station.time_ns, station.index, log)

    detected = [
        (a, b)
        for a, b in zip(left, right, strict=True)
        if isinstance(a, Detection) and isinstance(b, Detection)
    ]
    if not detected:
        return rejected(*_no_pair(left, right))
    images_left = StationCorners.of([a for a, _ in detected], board)
    images_right = StationCorners.of([b for _, b in detected], board)
    drift_px = np.maximum(images_left.drift_px, images_right.drift_px)
    claimed_px = float(np.median([max(a.sigma_px, b.sigma_px) for a, b in detected]))
    limit_px = max(_MAX_DRIFT_PX, _DRIFT_SIGMAS * claimed_px)
    still = drift_px <= limit_px
    if 2 * np.sum(still) <= len(detected):
        return rejected(
            "board or robot moved during the stop",
            f"corners drift by {drift_px.max():.2f} px over {len(detected)} stereo pairs, limit {limit_px:.2f} px",
        )
    corners_left = images_left.select(still).average(board, rig.left)
    corners_right = images_right.select(still).average(board, rig.right)
    both = corners_left.seen & corners_right.seen
    if both.sum() < _LEAST_IN_BOTH:
        return rejected(
            "board partly occluded or outside the image",
            f"{both.sum()} of {board.corners} corners visible in both images, minimum {_LEAST_IN_BOTH}",
        )
    points, corners_right = _best_fit(rig, corners_left, corners_right, board)
    if isinstance(points, Miss):
        return rejected(points.reason, points.detail)
    grid = board.grid()[both]
    rough_m = square_from_points(points.points_c, grid)
    start = absolute_orientation(points.points_c, rough_m * grid)
    pictures = _seen_by_both(corners_left, corners_right)
    pose = board_pose(rig, rough_m * grid, *pictures, start, free_scale=True)
    return Measured(log, station, rig, board, corners_left, corners_right, points, pose, rough_m)


def resolve_square(measured: Measured, square_m: float | None) -> Observation | Rejection:
    """Observation of a station, with a known square size.

    Args:
        measured: corners and board at the station.
        square_m: side of a square, m; None uses the station's own estimate.

    Returns:
        The observation, or a rejection. `Observation.square_m` is always the station's own estimate.
    """
    m, pose, left, right = measured, measured.pose, measured.left, measured.right
    if square_m is not None:
        tolerance_m = max(SQUARE_TOLERANCE * square_m, _SQUARE_SIGMAS * m.rough_m * pose.scale_sigma)
        if abs(m.square_m - square_m) > tolerance_m:
            return m.rejected(
                "unexpected square size",
                f"triangulated squares are {1e3 * m.square_m:.1f} mm wide, expected {1e3 * square_m:.1f} mm",
            )
        grid = m.board.grid()[left.seen & right.seen]
        R_c_k, t_c_k = pose.T_c_k[:3, :3], pose.T_c_k[:3, 3]
        # Start from the pose that keeps the board's size in the images.
        start = se3.transform(R_c_k, t_c_k * square_m / m.square_m)
        pose = board_pose(m.rig, square_m * grid, *_seen_by_both(left, right), start)
    if m.board.markers is not None:  # few corners with distortion underestimate their noise
        left, right = (
            replace(corners, sigma_px=max(min(corners.sigma_px, pose.rms_px), FLOOR_PX))
            for corners in (left, right)
        )
    side_m = m.square_m if square_m is None else square_m
    whole = _completed(m.rig, pose, side_m * m.board.grid(), m.points, left, right)
    return Observation(
        log=m.log,
        station=m.station.index,
        time_ns=m.station.time_ns,
        at_rest=m.station.at_rest,
        joints=m.station.joints,
        joints_std=m.station.joints_std,
        left=whole.left,
        right=whole.right,
        points_c=whole.points_c,
        points_cov=whole.points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        square_m=m.square_m,
        reprojection_px=pose.rms_px,
    )
