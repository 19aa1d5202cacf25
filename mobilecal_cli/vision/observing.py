"""One observation per station: mean corners, triangulated points and the board's pose from all its images."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.observations import Corners, Observation
from mobilecal_cli.model.rig import Board, Camera, CameraRig, camera_words, shots_words
from mobilecal_cli.model.signals import Reason, Rejection, Station
from mobilecal_cli.vision.grid import turned, turned_view, turns
from mobilecal_cli.vision.grid_map import roughness_px, scatter_px
from mobilecal_cli.vision.pose import (
    BoardPose,
    StereoPoints,
    absolute_orientation,
    board_pose,
    common,
    pose_from_one,
    square_from_points,
    triangulate,
)
from mobilecal_cli.vision.values import FLOOR_PX, LEAST_CORNERS, Detection, Miss, rms

_MAX_DRIFT_PX = 0.5
_DRIFT_SIGMAS = 4.0
#: Largest acceptable difference of a square's measured side from the stated one, as a share: this, or so many standard
#: deviations. More, where a wrong disparity by principal points that are a usual share of the image width off (one
#: standard deviation of their prior in each camera) makes as much: the estimate then shows which of them is wrong.
_SQUARE_TOLERANCE, _SQUARE_SIGMAS = 0.1, 5.0
_PRINCIPAL_SHARE, _PRINCIPAL_SIGMAS = 0.003 * math.sqrt(2), 3.0
#: Corners that are not detected are predicted up to so many image sizes away: a distortion model ends before.
_FARTHEST = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class StationCorners:
    """One camera's corners in all images of a station.

    Attributes:
        pixels: (n, M, 2) px, in a common numbering.
        seen: (n, M) whether each corner was detected.
        cov: (n, M, 2, 2) covariance from each corner's fit, px^2.
    """

    pixels: FloatArray
    seen: BoolArray
    cov: FloatArray

    @classmethod
    def of(cls, detections: Sequence[Detection], board: Board) -> StationCorners:
        """Bring every image to the numbering nearest to that of the first."""
        pixels, cov = [], []
        for d in detections:
            options = [(turned(d.pixels, board, k), k) for k in turns(board)]
            nearest, turn = min(
                options, key=lambda option: float(np.sum((option[0] - detections[0].pixels) ** 2))
            )
            pixels.append(nearest)
            cov.append(turned(d.cov, board, turn))
        return cls(np.stack(pixels), np.stack([d.seen for d in detections]), np.stack(cov))

    @property
    def drift_px(self) -> FloatArray:
        """(n,) distance of each image's corners from their median over all images, rms per coordinate, px."""
        if len(self.pixels) == 1:
            return np.zeros(1)
        measured = np.where(self.seen[..., None], self.pixels, np.nan)
        anywhere = self.seen.any(axis=0)
        off = measured[:, anywhere] - np.nanmedian(measured[:, anywhere], axis=0)
        return np.asarray(np.sqrt(np.nanmean(off**2, axis=(1, 2))))

    @property
    def mostly(self) -> BoolArray:
        """(M,) corners that more than half of the images show."""
        return np.asarray(2 * self.seen.sum(axis=0) > len(self.seen), dtype=np.bool_)

    def average(self, board: Board, camera: Camera) -> Corners:
        """Mean of the corners that more than half of the images show, with the noise of the mean.

        The noise is the scatter over the images, pooled over the corners and divided by sqrt(n). Its lower
        limit is the roughness of the mean grid, because refinement errors common to all images do not average
        out. Noise in excess of the fits' covariances is added equally to all corners.
        """
        n, mostly = len(self.pixels), self.mostly
        weight = (self.seen & mostly)[..., None]
        mean = np.sum(self.pixels * weight, axis=0) / np.maximum(weight.sum(axis=0), 1)
        if board.markers is None:
            roughness = roughness_px(camera, mean.reshape(board.rows, board.columns, 2))
        else:
            roughness = rms(scatter_px(board.grid()[mostly, :2], mean[mostly]))
        sigma_px = max(roughness, FLOOR_PX)
        if n > 1:
            freedom = max(2 * (int(weight.sum()) - int(mostly.sum())), 1)
            scatter = np.sqrt(np.sum(weight * (self.pixels - mean) ** 2) / freedom)
            sigma_px = max(sigma_px, float(scatter / np.sqrt(n)))
        times = np.maximum(weight.sum(axis=0), 1)[..., None]
        claimed = np.sum(self.cov * weight[..., None], axis=0) / times**2
        usual = float(np.median(np.trace(claimed[mostly], axis1=1, axis2=2))) / 2
        cov = claimed + max(sigma_px**2 - usual, 0.0) * np.eye(2)
        sigma_px = max(sigma_px, float(np.sqrt(usual)))
        return Corners(
            mean, sigma_px, n, mostly, np.where(mostly[:, None, None], cov / sigma_px**2, np.eye(2))
        )


def _unusable(names: Sequence[str], shots: Sequence[Sequence[Detection | Miss | None]]) -> tuple[str, str]:
    """Reason and detail for a station without images that show the board to enough cameras."""
    by_camera = zip(names, zip(*shots, strict=True), strict=True)
    misses = {name: [item for item in items if isinstance(item, Miss)] for name, items in by_camera}
    every = [miss for of_camera in misses.values() for miss in of_camera]
    what = shots_words(len(names))
    detail = f"{len(shots)} {what}"
    for name, items in misses.items():
        first = {miss.reason: miss.detail for miss in reversed(items)}
        counts = Counter(miss.reason for miss in items).most_common()
        said = (f"{count} x {reason} ({first[reason]})" for reason, count in counts)
        detail += f"; {name}: {'; '.join(said)}" if items else ""
    return Counter(miss.reason for miss in every).most_common(1)[0][0], detail


def best_fit(
    rig: CameraRig, views: Sequence[Corners], board: Board
) -> tuple[StereoPoints | Miss, tuple[Corners, ...]]:
    """Triangulate the corners that all cameras see, after renumbering the other images to match the first.

    The numbering that fits best is used. The rows of any other are several squares apart.
    """
    fits: list[tuple[StereoPoints | Miss, tuple[Corners, ...]]] = []
    for others in product(turns(board), repeat=len(views) - 1):
        option = (views[0], *(turned_view(view, board, k) for view, k in zip(views[1:], others, strict=True)))
        fits.append((triangulate(rig, option), option))
    return min(fits, key=lambda fit: fit[0].rms_px if isinstance(fit[0], StereoPoints) else np.inf)


def _by_one(
    rig: CameraRig, views: Sequence[Corners], board: Board, square_m: float
) -> tuple[BoardPose | Miss, tuple[Corners, ...]]:
    """Board pose by the camera that shows most corners; those of the other cameras are numbered as this pose expects.

    Cameras whose poses are only described are too far off for triangulation: 1 degree is more than the disparity shows.
    """
    most = max(range(len(views)), key=lambda k: int(views[k].seen.sum()))
    points_k = square_m * board.grid()
    pose = pose_from_one(rig.some((most,)), points_k, views[most])
    if isinstance(pose, Miss):
        return pose, tuple(views)
    numbered = []
    for k, view in enumerate(views):
        expected = project(rig.each[k], se3.act(se3.inverse(rig.T_c_each[k]) @ pose.T_c_k, points_k))
        options = [turned_view(view, board, turn) for turn in turns(board)] if k != most else [view]
        off_px = [np.linalg.norm((o.pixels - expected)[o.seen], axis=-1).mean() for o in options]
        numbered.append(options[int(np.argmin(off_px))])
    return pose, tuple(numbered)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The board at one station. With two or more cameras, their distance gives the size of its squares.

    Attributes:
        station: its shots and joint readings.
        rig, board: all cameras, and the board to detect.
        shown: indices of the cameras that show the board.
        views: all corners in the image of each of these; some may not be detected.
        points: corners that both cameras of a stereo pair see, triangulated; None of other cameras.
        pose: of the board, with free scale, fitted to unit squares times `rough_m`; by one camera, with this size.
        rough_m: initial estimate of a square's side, m; without `points`, the stated one, or 1 m.
    """

    station: Station
    rig: CameraRig
    board: Board
    shown: tuple[int, ...]
    views: tuple[Corners, ...]
    points: StereoPoints | None
    pose: BoardPose
    rough_m: float

    @property
    def square_m(self) -> float:
        """Side of a square as measured at this station, m; `rough_m` without `points`."""
        return self.rough_m * self.pose.scale

    @property
    def square_tolerance(self) -> float:
        """Largest acceptable difference of `square_m` from the stated one, as a share."""
        first, baseline_m = self.rig.each[0], self.rig.baseline_m or math.inf
        disparity_px = first.K[0, 0] * baseline_m / self.pose.T_c_k[2, 3]
        usual = _PRINCIPAL_SIGMAS * _PRINCIPAL_SHARE * first.width / disparity_px
        return max(_SQUARE_TOLERANCE, float(usual))

    def rejected(self, reason: str, detail: str) -> Rejection:
        """Rejection of this station."""
        return _rejection(self.station, reason, detail)


def _rejection(station: Station, reason: str, detail: str) -> Rejection:
    return Rejection("vision", str(reason), detail, station.time_ns, station.index)


def _showing(
    shots: Sequence[Sequence[Detection | Miss | None]],
) -> tuple[tuple[int, ...], list[list[Detection]]]:
    """The largest group of cameras that show the board together, and their detections in each shot in which they do."""
    groups = Counter(tuple(k for k, item in enumerate(shot) if isinstance(item, Detection)) for shot in shots)
    best = max(groups, key=lambda group: (len(group), groups[group]))
    detected = [[item for k in best if isinstance(item := shot[k], Detection)] for shot in shots]
    return best, [together for together in detected if len(together) == len(best)]


def measure(
    station: Station,
    shots: Sequence[Sequence[Detection | Miss | None]],
    rig: CameraRig,
    board: Board,
) -> Measured | Rejection:
    """Average and triangulate the corners of a station.

    Args:
        station: its shots and joint readings.
        shots: detection in the image of each camera, for each shot, in the order of `station.shots`; None: no image.
        rig: the cameras.
        board: the board's size, and the size of its squares where it is known.

    Returns:
        The board at this station, or a rejection.
    """
    rejected = partial(_rejection, station)
    shown, detected = _showing(shots)
    if not shown:
        return rejected(*_unusable(rig.names, shots))
    images = [StationCorners.of(together, board) for together in zip(*detected, strict=True)]
    drift_px = np.max([of_camera.drift_px for of_camera in images], axis=0)
    claimed_px = float(np.median([max(d.sigma_px for d in together) for together in detected]))
    limit_px = max(_MAX_DRIFT_PX, _DRIFT_SIGMAS * claimed_px)
    still = drift_px <= limit_px
    if 2 * np.sum(still) <= len(detected):
        what = "stereo pairs" if len(shown) > 1 else "images"
        return rejected(
            "board or robot moved during the stop",
            f"corners drift by {drift_px.max():.2f} px over {len(detected)} {what}, limit {limit_px:.2f} px",
        )
    images = [StationCorners(of.pixels[still], of.seen[still], of.cov[still]) for of in images]
    corners = [int(of_camera.mostly.sum()) for of_camera in images]
    if max(corners) < LEAST_CORNERS:
        return rejected(
            Reason.OCCLUDED,
            f"{max(corners)} of {board.corners} corners visible in an image, minimum {LEAST_CORNERS}",
        )
    enough = [k for k, count in enumerate(corners) if count >= LEAST_CORNERS]
    views = tuple(images[k].average(board, rig.each[shown[k]]) for k in enough)
    shown = tuple(shown[k] for k in enough)
    if len(shown) == 1 or not rig.calibrated or common(views).sum() < LEAST_CORNERS:
        if rig.calibrated:
            most = max(range(len(views)), key=lambda k: int(views[k].seen.sum()))
            shown, views = (shown[most],), (views[most],)
        square_m = board.square_m or 1.0
        pose, views = _by_one(rig.some(shown), views, board, square_m)
        if isinstance(pose, Miss):
            return rejected(pose.reason, pose.detail)
        return Measured(station, rig, board, shown, views, None, pose, square_m)
    own, grid = rig.some(shown), board.grid()
    points, views = best_fit(own, views, board)
    if isinstance(points, Miss):
        return rejected(points.reason, points.detail)
    both = common(views)
    rough_m = square_from_points(points.points_c, grid[both])
    start = absolute_orientation(points.points_c, rough_m * grid[both])
    pose = board_pose(own, rough_m * grid, views, start, free_scale=True)
    return Measured(station, rig, board, shown, views, points, pose, rough_m)


def _completed(
    m: Measured, pose: BoardPose, views: Sequence[Corners], points_k: FloatArray, log: int
) -> Observation:
    """The observation of all corners: detected ones, and the others predicted from the board's pose."""
    points_c = se3.act(pose.T_c_k, points_k)
    moves = se3.by_twist(points_c)
    points_cov = moves @ pose.T_c_k_cov @ np.swapaxes(moves, -1, -2)
    count, whole = len(points_c), []
    unseen = Corners(
        np.zeros((count, 2)), 1.0, 0, np.zeros(count, np.bool_), np.broadcast_to(np.eye(2), (count, 2, 2))
    )
    for k, lens in enumerate(m.rig.each):
        view = views[m.shown.index(k)] if k in m.shown else unseen
        if not view.seen.all():
            own_points = se3.act(se3.inverse(m.rig.T_c_each[k]), points_c)
            ahead = own_points[:, 2:] > 0
            expected = project(lens, np.where(ahead, own_points, [0.0, 0.0, 1.0]))
            near = np.abs(expected).max(axis=1, keepdims=True) < _FARTHEST * max(lens.width, lens.height)
            expected = np.where(ahead & near, expected, 0.0)
            view = replace(view, pixels=np.where(view.seen[:, None], view.pixels, expected))
        whole.append(view)
    if m.points is not None:
        both = common(views)
        points_c[both], points_cov[both] = m.points.points_c, m.points.points_cov
    return Observation(
        log=log,
        station=m.station.index,
        time_ns=m.station.time_ns,
        at_rest=m.station.at_rest,
        joints=m.station.joints,
        joints_std=m.station.joints_std,
        views=tuple(whole),
        points_c=points_c,
        points_cov=points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        square_m=m.square_m,
        reprojection_px=pose.rms_px,
    )


def resolve_square(measured: Measured, square_m: float | None, log: int = 0) -> Observation | Rejection:
    """Observation of a station, with a known square size.

    Args:
        measured: corners and board at the station.
        square_m: side of a square, m; None uses the station's own estimate.
        log: index of the recording.

    Returns:
        The observation, or a rejection. `Observation.square_m` is the station's own estimate, of one camera `square_m`.
    """
    m, pose, views = measured, measured.pose, measured.views
    own = m.rig.some(m.shown)
    if m.points is None and square_m != m.rough_m:
        if square_m is None:
            return m.rejected(
                Reason.SQUARES_UNKNOWN,
                f"only the {camera_words(m.rig.names[m.shown[0]])} sees the board, and board.square_m is not set",
            )
        from_one, views = _by_one(own, views, m.board, square_m)
        if isinstance(from_one, Miss):
            return m.rejected(from_one.reason, from_one.detail)
        m, pose = replace(m, rough_m=square_m), from_one
    elif square_m is not None and m.points is not None:
        tolerance_m = max(m.square_tolerance * square_m, _SQUARE_SIGMAS * m.rough_m * pose.scale_sigma)
        if abs(m.square_m - square_m) > tolerance_m:
            return m.rejected(
                "unexpected square size",
                f"triangulated squares are {1e3 * m.square_m:.1f} mm wide, expected {1e3 * square_m:.1f} mm",
            )
        R_c_k, t_c_k = pose.T_c_k[:3, :3], pose.T_c_k[:3, 3]
        # Start from the pose that keeps the board's size in the images.
        start = se3.transform(R_c_k, t_c_k * square_m / m.square_m)
        pose = board_pose(own, square_m * m.board.grid(), views, start)
    if m.board.markers is not None:  # few corners with distortion underestimate their noise
        views = tuple(
            replace(view, sigma_px=max(min(view.sigma_px, pose.rms_px), FLOOR_PX)) for view in views
        )
    side_m = m.square_m if square_m is None else square_m
    return _completed(m, pose, views, side_m * m.board.grid(), log)
