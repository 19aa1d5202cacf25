"""From the board in the pictures of a station to one observation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import (
    Board,
    BoolArray,
    Corners,
    FloatArray,
    Observation,
    Rejection,
    Station,
    StereoRig,
)
from mobilecal_cli.vision.grid import fit_grid, scatter_px, turned, turns
from mobilecal_cli.vision.pose import absolute_orientation, board_pose, square_from_points
from mobilecal_cli.vision.stereo import reproject, triangulate
from mobilecal_cli.vision.values import BoardPose, Detection, Miss, StereoPoints, rms

_MAX_DRIFT_PX = 0.5
_DRIFT_SIGMAS = 4.0
_MAX_EPIPOLAR_RMS_PX = (
    1.5  # rows of the two pictures about 4 px apart: the stereo calibration is not this rig's
)
_MAX_REPROJECTION_PX = 3.0
_SQUARE_TOLERANCE = 0.1
_SQUARE_SIGMAS = 5.0
_LEAST_IN_BOTH = 8  # of a board with markers, of which a part is enough
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


@dataclass(frozen=True, slots=True, eq=False)
class _Shots:
    """One camera's corners in the shots of a station.

    Attributes:
        pixels: (n, M, 2), all in one numbering.
        seen: (n, M) the corners that were seen.
        cov: (n, M, 2, 2) what each one's fit claims, px^2.
    """

    pixels: FloatArray
    seen: BoolArray
    cov: FloatArray

    @classmethod
    def of(cls, found: Sequence[Detection], board: Board) -> _Shots:
        """Each shot in the numbering nearest to the first shot's."""
        pixels, cov = [], []
        for d in found:
            options = [(_turned(d.pixels, board, k), k) for k in _turns(board)]
            nearest, turn = min(options, key=lambda option: float(np.sum((option[0] - found[0].pixels) ** 2)))
            pixels.append(nearest)
            cov.append(_turned(d.cov, board, turn))
        return cls(np.stack(pixels), np.stack([d.seen for d in found]), np.stack(cov))

    def select(self, kept: BoolArray) -> _Shots:
        """Some of the shots."""
        return _Shots(self.pixels[kept], self.seen[kept], self.cov[kept])

    @property
    def drift_px(self) -> FloatArray:
        """(n,) how far each shot's corners lie from the middle of all shots, rms per coordinate."""
        measured = np.where(self.seen[..., None], self.pixels, np.nan)
        anywhere = self.seen.any(axis=0)
        off = measured[:, anywhere] - np.nanmedian(measured[:, anywhere], axis=0)
        return np.asarray(np.sqrt(np.nanmean(off**2, axis=(1, 2))))

    def average(self, board: Board) -> Corners:
        """Corners averaged over the shots, those that most shots show, with the noise of the average.

        The noise is the scatter over the shots, pooled over the corners, divided by sqrt(n); but no less than what
        the average's own roughness shows: errors of refinement that are the same in every shot do not average out.
        What it is more than the fits claim, it is for all corners alike.
        """
        n, seen = len(self.pixels), 2 * self.seen.sum(axis=0) > len(self.pixels)
        weight = (self.seen & seen)[..., None]
        mean = np.sum(self.pixels * weight, axis=0) / np.maximum(weight.sum(axis=0), 1)
        if board.markers is None:
            roughness = fit_grid(mean.reshape(board.rows, board.columns, 2)).sigma_px
        else:
            roughness = rms(scatter_px(board.grid()[seen, :2], mean[seen]))
        sigma_px = max(roughness, _FLOOR_PX)
        if n > 1:
            freedom = max(2 * (int(weight.sum()) - int(seen.sum())), 1)
            scatter = np.sqrt(np.sum(weight * (self.pixels - mean) ** 2) / freedom)
            sigma_px = max(sigma_px, float(scatter / np.sqrt(n)))
        times = np.maximum(weight.sum(axis=0), 1)[..., None]
        claimed = np.sum(self.cov * weight[..., None], axis=0) / times**2
        usual = float(np.median(np.trace(claimed[seen], axis1=1, axis2=2))) / 2
        cov = claimed + max(sigma_px**2 - usual, 0.0) * np.eye(2)
        sigma_px = max(sigma_px, float(np.sqrt(usual)))
        return Corners(mean, sigma_px, n, seen, np.where(seen[:, None, None], cov / sigma_px**2, np.eye(2)))


def _turns(board: Board) -> tuple[int, ...]:
    """Quarter turns that give the numberings which corners could have: one, where markers tell it."""
    return (0,) if board.markers is not None else turns(board.columns, board.rows)


def _turned(values: FloatArray, board: Board, quarter_turns: int) -> FloatArray:
    return turned(values, board.columns, board.rows, quarter_turns) if quarter_turns else values


def _best_fit(
    rig: StereoRig, left: Corners, right: Corners, board: Board
) -> tuple[StereoPoints | Miss, Corners]:
    """Corners that both see, triangulated, with the right picture numbered so that it fits the left one best."""
    options = [
        replace(
            right,
            pixels=_turned(right.pixels, board, k),
            relative_cov=_turned(right.relative_cov, board, k),
        )
        for k in _turns(board)
    ]
    both = left.seen & right.seen
    fits = [
        triangulate(rig, left.pixels[both], option.pixels[both], left.cov_px2[both], option.cov_px2[both])
        for option in options
    ]
    best = min(
        range(len(fits)), key=lambda i: fit.rms_px if isinstance(fit := fits[i], StereoPoints) else np.inf
    )
    return fits[best], options[best]


@dataclass(frozen=True, slots=True, eq=False)
class _Whole:
    """All corners of the board: those that were seen, and the others where its pose has them."""

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
    shots_left = _Shots.of([a for a, _ in pairs], board)
    shots_right = _Shots.of([b for _, b in pairs], board)
    drift_px = np.maximum(shots_left.drift_px, shots_right.drift_px)
    claimed_px = float(np.median([max(a.sigma_px, b.sigma_px) for a, b in pairs]))
    limit_px = max(_MAX_DRIFT_PX, _DRIFT_SIGMAS * claimed_px)
    still = drift_px <= limit_px
    if 2 * np.sum(still) <= len(pairs):
        return rejected(
            "board or robot moved during the rest",
            f"corners drift by up to {drift_px.max():.2f} px over {len(pairs)} shots, limit {limit_px:.2f} px",
        )
    corners_left, corners_right = (shots.select(still).average(board) for shots in (shots_left, shots_right))
    both = corners_left.seen & corners_right.seen
    if both.sum() < _LEAST_IN_BOTH:
        return rejected(
            "board partly hidden or cut off by the border",
            f"{both.sum()} of {board.corners} corners are in both pictures, need {_LEAST_IN_BOTH}",
        )
    points, corners_right = _best_fit(rig, corners_left, corners_right, board)
    if isinstance(points, Miss):
        return rejected(points.reason, points.detail)
    if points.rms_px > _MAX_EPIPOLAR_RMS_PX:
        return rejected(
            "left and right do not fit together",
            f"corners are {points.rms_px:.2f} px rms off the epipolar lines, limit {_MAX_EPIPOLAR_RMS_PX} px",
        )
    grid = board.grid()[both]
    pictures = (
        corners_left.pixels[both],
        corners_right.pixels[both],
        corners_left.cov_px2[both],
        corners_right.cov_px2[both],
    )
    rough_m = square_from_points(points.points_c, grid)
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
    if board.markers is not None:  # few corners and a bent picture make a careless claim of their noise
        corners_left, corners_right = (
            replace(corners, sigma_px=max(min(corners.sigma_px, pose.rms_px), _FLOOR_PX))
            for corners in (corners_left, corners_right)
        )
    side_m = seen_m if square_m is None else square_m
    whole = _completed(rig, pose, side_m * board.grid(), points, corners_left, corners_right)
    return Observation(
        log=log,
        station=station.index,
        time_ns=station.time_ns,
        at_rest=station.at_rest,
        joints=station.joints,
        joints_std=station.joints_std,
        left=whole.left,
        right=whole.right,
        points_c=whole.points_c,
        points_cov=whole.points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        square_m=seen_m,
        reprojection_px=pose.rms_px,
    )
