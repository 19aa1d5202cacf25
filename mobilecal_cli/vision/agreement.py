"""Whether the stations of a recording agree with camera_info and the board.

A station that disagrees more than the others is a bad image. A disagreement of all stations is a property of the
description: they are kept, and the estimate finds what is wrong with it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mobilecal_cli.errors import ObservationError
from mobilecal_cli.model import Board, CameraRig, FloatArray, Rejection
from mobilecal_cli.vision.averaging import turned_board, turns_of
from mobilecal_cli.vision.observing import INCONSISTENT, SQUARE_TOLERANCE, Measured
from mobilecal_cli.vision.stereo import triangulate
from mobilecal_cli.vision.values import Detection, StereoPoints

Pair = tuple[Detection, Detection]
Pixels = tuple[FloatArray, FloatArray]
_EPIPOLAR_PX = 1.5  # rows of the two images about 4 px apart
_FLAT_PX = 3.0
_TIMES_THE_MEDIAN = 3.0
_UNIT_TOLERANCE = 0.3  # a wrong unit is off by far more
_UNITS = {"millimeters": 1000.0, "centimeters": 100.0, "inches": 1 / 0.0254}
_FEWEST = 5  # stations that make a median
_SAME_PX = 1.0  # corners that do not move
#: A misfit of this size is beyond the priors of camera_info: the estimate does not find its cause.
_GROSS_PX = 5.0
_RECALIBRATE = (
    "check that each camera_info belongs to its images (left and right, resolution, crop), or calibrate the stereo "
    "pair again"
)


def agreeing(measured: Sequence[Measured | Rejection]) -> tuple[list[Measured | Rejection], tuple[str, ...]]:
    """Reject stations whose images disagree more than those of the others.

    Args:
        measured: stations of one recording.

    Returns:
        The stations, and a note if all of them disagree with camera_info.
    """
    found = [one for one in measured if isinstance(one, Measured)]
    epipolar_px, common_px = _limit(
        [one.points.rms_px for one in found if one.points is not None], _EPIPOLAR_PX
    )
    flat_px, _ = _limit([one.pose.rms_px for one in found], _FLAT_PX)
    notes: tuple[str, ...] = ()
    if common_px > _EPIPOLAR_PX:
        notes = (
            f"camera_info does not fit the images: corners are {common_px:.1f} px from their epipolar lines at the "
            f"median station (limit {_EPIPOLAR_PX} px). Stations that share this misfit are kept, and the estimate "
            "corrects camera_info as far as its priors allow.",
        )
    return [
        _judged(one, epipolar_px, flat_px) if isinstance(one, Measured) else one for one in measured
    ], notes


def _limit(rms_px: Sequence[float], usual_px: float) -> tuple[float, float]:
    """Largest acceptable misfit, px, and the median over the stations, px: 0 for a few of them."""
    common_px = float(np.median(rms_px)) if len(rms_px) >= _FEWEST else 0.0
    return max(usual_px, _TIMES_THE_MEDIAN * common_px), common_px


def _judged(one: Measured, epipolar_px: float, flat_px: float) -> Measured | Rejection:
    if one.points is not None and one.points.rms_px > epipolar_px:
        detail = (
            f"distance from the epipolar lines {one.points.rms_px:.2f} px rms, limit {epipolar_px:.1f} px"
        )
    elif one.pose.rms_px > flat_px:
        detail = (
            f"a flat board fits the corners with an rms of {one.pose.rms_px:.2f} px, limit {flat_px:.1f} px"
        )
    else:
        return one
    return one.rejected(INCONSISTENT, detail)


def _exchanged(_: CameraRig, board: Board, left: FloatArray, right: FloatArray) -> list[Pixels]:
    return [(right, left)]


def _mirrored(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray) -> list[Pixels]:
    return [([rig.each[0].width - 1, 0] + left * [-1, 1], [rig.each[1].width - 1, 0] + right * [-1, 1])]


def _left_mirrored(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray) -> list[Pixels]:
    ((corners, _),) = _mirrored(rig, board, left, right)
    return [(numbered, right) for numbered in _as_mirrored(board, corners)]


def _right_mirrored(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray) -> list[Pixels]:
    ((_, corners),) = _mirrored(rig, board, left, right)
    return [(left, numbered) for numbered in _as_mirrored(board, corners)]


def _as_mirrored(board: Board, corners: FloatArray) -> list[FloatArray]:
    """Corners (M, 2) as a mirrored image may number them: from the other end of the rows, or of the columns."""
    grid = corners.reshape(board.rows, board.columns, 2)
    return [grid[:, ::-1].reshape(-1, 2), grid[::-1].reshape(-1, 2)]


def _upside_down(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray) -> list[Pixels]:
    ends = [[camera.width - 1, camera.height - 1] for camera in rig.each]
    return [(ends[0] - left, ends[1] - right)]


#: What may have happened to the images, what undoes it on the corners, and the cure.
_MISTAKES: Mapping[str, tuple[Callable[[CameraRig, Board, FloatArray, FloatArray], list[Pixels]], str]] = {
    "the left and the right images are exchanged": (
        _exchanged,
        "exchange cameras.left.image and cameras.right.image in rig.yaml, or connect the cameras the other way round",
    ),
    "the images of both cameras are mirrored": (
        _mirrored,
        "switch the mirroring of the camera driver off, and record again",
    ),
    "the images of the left camera are mirrored": (
        _left_mirrored,
        "switch the mirroring of the left camera's driver off, and record again",
    ),
    "the images of the right camera are mirrored": (
        _right_mirrored,
        "switch the mirroring of the right camera's driver off, and record again",
    ),
    "the images of both cameras are upside down": (
        _upside_down,
        "calibrate the stereo pair with images as recorded, or switch the rotation of the camera driver off",
    ),
}


_LATE = "the images of the right camera are those of the station before"
_EARLY = "the images of the left camera are those of the station before"
_CLOCK = "check that both cameras send each image at once, with the time of its exposure, and record again"


def _misfit_px(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray, seen: Pair) -> float:
    """Distance of the corners of one stereo pair from their epipolar lines, px rms."""
    both = seen[0].seen & seen[1].seen
    best = np.inf
    for turns in turns_of(board):
        points = triangulate(rig, [left[both], turned_board(right, board, turns)[both]], [1.0, 1.0])
        if isinstance(points, StereoPoints):
            best = min(best, points.rms_px)
    return best


def _check_repeated(pairs: Sequence[Pair]) -> None:
    """Refuse images that are those of the other camera, or always the same.

    Raises:
        ObservationError: names the camera.
    """
    corners = np.stack([[a.pixels, b.pixels] for a, b in pairs])
    apart_px = np.abs(corners[:, 0] - corners[:, 1]).max(axis=(1, 2))
    if np.median(apart_px) < _SAME_PX:
        raise ObservationError(
            "both image topics carry the images of the same camera: the corners are at the same pixels "
            f"(median {np.median(apart_px):.2g} px apart) in {len(pairs)} stereo pairs",
            "check cameras.left.image and cameras.right.image in rig.yaml, and the topics of the camera driver",
        )
    moved_px = np.median(np.abs(np.diff(corners, axis=0)).max(axis=(2, 3)), axis=0)
    for side, own_px, other_px in (("left", *moved_px), ("right", *moved_px[::-1])):
        if own_px < _SAME_PX and other_px > _GROSS_PX:
            raise ObservationError(
                f"the images of the {side} camera do not change: the corners move by {own_px:.2g} px between "
                f"stations, and by {other_px:.0f} px in the other camera",
                "restart the driver of this camera, check that its images are not old ones, and record again",
            )


def check_arrangement(
    measured: Sequence[Measured | Rejection], pairs: Sequence[Pair], rig: CameraRig, board: Board
) -> None:
    """Name the mistake if the images of a stereo pair cannot belong to camera_info at most stations.

    Args:
        measured: the stations of a recording.
        pairs: the board in the first stereo pair of stations that show it in both images.
        rig, board: as described.

    Raises:
        ObservationError: the images are exchanged, mirrored, upside down, of one camera or of another station, or
            camera_info is grossly wrong.
    """
    if not rig.calibrated:
        return
    if len(pairs) >= _FEWEST:
        _check_repeated(pairs)
    gross = [
        isinstance(one, Rejection) or (one.points is not None and one.points.rms_px > _GROSS_PX)
        for one in measured
        if (one.reason == INCONSISTENT if isinstance(one, Rejection) else one.points is not None)
    ]
    if sum(gross) < _FEWEST or 2 * sum(gross) < len(gross):
        return
    misfits_px = {
        mistake: float(
            np.median(
                [
                    min(_misfit_px(rig, board, *p, (a, b)) for p in undo(rig, board, a.pixels, b.pixels))
                    for a, b in pairs
                ]
            )
        )
        for mistake, (undo, _) in _MISTAKES.items()
    }
    for by, mistake in ((1, _LATE), (-1, _EARLY)):
        shifted = [(a, b) for (a, _), (_, b) in itertools.pairwise(pairs[::by])]
        apart_px = [_misfit_px(rig, board, a.pixels, b.pixels, (a, b)) for a, b in shifted]
        misfits_px[mistake] = float(np.median(apart_px)) if apart_px else np.inf
    likely = min(misfits_px, key=lambda mistake: misfits_px[mistake])
    facts = (
        f"at {sum(gross)} of {len(gross)} stations, corners are behind a camera, or more than {_GROSS_PX:g} px from "
        "their epipolar lines"
    )
    if misfits_px[likely] <= _EPIPOLAR_PX:
        raise ObservationError(
            f"{likely}: {facts}; with this undone, they are {misfits_px[likely]:.1f} px away",
            _MISTAKES[likely][1] if likely in _MISTAKES else _CLOCK,
        )
    raise ObservationError(f"camera_info does not fit the images: {facts}", _RECALIBRATE)


def check_square(measured: Sequence[Measured | Rejection], square_m: float) -> None:
    """Compare the stated side of a square with the stereo pair's.

    Raises:
        ObservationError: they differ at the median of enough stations; names a unit given as meters.
    """
    sides_m = [one.square_m for one in measured if isinstance(one, Measured) and one.points is not None]
    if len(sides_m) < _FEWEST:
        return
    side_m = float(np.median(sides_m))
    if abs(side_m - square_m) <= SQUARE_TOLERANCE * square_m:
        return
    cure = square_cure(square_m, side_m)
    raise ObservationError(
        f"the squares are {side_m:.3g} m wide at the median of {len(sides_m)} stations, but board.square_m is "
        f"{square_m:g} m (limit {100 * SQUARE_TOLERANCE:g} %)",
        cure,
    )


def square_cure(square_m: float, side_m: float) -> str:
    """What to do about squares that do not have their stated side, m, but another one, m."""
    for unit, per_meter in _UNITS.items():
        if abs(square_m / per_meter - side_m) <= _UNIT_TOLERANCE * side_m:
            return (
                f"{square_m:g} looks like {unit}: set board.square_m to {square_m / per_meter:.4g} (meters)"
            )
    return "correct board.square_m, or calibrate the stereo pair again (camera_info)"
