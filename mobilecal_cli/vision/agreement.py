"""Whether the stations of a recording agree with camera_info and the board.

A station that disagrees more than the others is a bad image. A disagreement of all stations is a property of the
description: they are kept, and the estimate finds what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, product

import numpy as np

from mobilecal_cli.errors import ObservationError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import Board, Camera, CameraRig
from mobilecal_cli.model.signals import Reason, Rejection
from mobilecal_cli.vision.observing import Measured, best_fit
from mobilecal_cli.vision.pose import StereoPoints
from mobilecal_cli.vision.values import Detection

Pair = tuple[Detection, Detection]
_EPIPOLAR_PX = 1.5  # rows of the two images about 4 px apart
_FLAT_PX = 3.0  # corners that far off a plane are not those of a board
_TIMES_THE_MEDIAN = 3.0  # misfit that sets a station apart from the others of a recording
_UNIT_TOLERANCE = 0.3  # a wrong unit is off by far more
_UNITS = {"millimeters": 1000.0, "centimeters": 100.0, "inches": 1 / 0.0254}
_FEWEST = 5  # stations that make a median
_SAME_PX = 1.0  # corners that do not move
#: A misfit of this size is beyond the priors of camera_info: the estimate does not find its cause.
_GROSS_PX = 5.0
_NEARLY_ALL = 0.8  # share of the stations: at fewer, something changed during the recording
_IN_PART = "this is not so at the other stations: check cables and drivers of the cameras, and record again"
_RECALIBRATE = (
    "check that each camera_info belongs to its images (left and right, resolution, crop), or calibrate the stereo "
    "pair again"
)
_EXCHANGED = "the left and the right images are exchanged"
_LATE = "the images of the right camera are those of the station before"
_EARLY = "the images of the left camera are those of the station before"
_CLOCK = "check that both cameras send each image at once, with the time of its exposure, and record again"


def agreeing(measured: Sequence[Measured | Rejection]) -> tuple[list[Measured | Rejection], tuple[str, ...]]:
    """Reject stations whose images disagree more than those of the others.

    Args:
        measured: stations of one recording.

    Returns:
        The stations, and a note if all of them disagree with camera_info.
    """
    stations = [station for station in measured if isinstance(station, Measured)]
    epipolar_px, common_px = _limit(
        [station.points.rms_px for station in stations if station.points is not None], _EPIPOLAR_PX
    )
    flat_px, _ = _limit([station.pose.rms_px for station in stations], _FLAT_PX)

    def judged(station: Measured | Rejection) -> Measured | Rejection:
        if isinstance(station, Rejection):
            return station
        if station.points is not None and station.points.rms_px > epipolar_px:
            return station.rejected(
                Reason.INCONSISTENT,
                f"distance from the epipolar lines {station.points.rms_px:.2f} px rms, limit {epipolar_px:.1f} px",
            )
        if station.pose.rms_px > flat_px:
            return station.rejected(
                Reason.INCONSISTENT,
                f"a flat board fits the corners with an rms of {station.pose.rms_px:.2f} px, limit {flat_px:.1f} px",
            )
        return station

    notes: tuple[str, ...] = ()
    if common_px > _EPIPOLAR_PX:
        notes = (
            f"camera_info does not fit the images: corners are {common_px:.1f} px from their epipolar lines at the "
            f"median station (limit {_EPIPOLAR_PX} px). Stations that share this misfit are kept, and the estimate "
            "corrects camera_info as far as its priors allow.",
        )
    return [judged(station) for station in measured], notes


def _limit(rms_px: Sequence[float], usual_px: float) -> tuple[float, float]:
    """Largest acceptable misfit, px, and the median over the stations, px: 0 for a few of them."""
    common_px = float(np.median(rms_px)) if len(rms_px) >= _FEWEST else 0.0
    return max(usual_px, _TIMES_THE_MEDIAN * common_px), common_px


def _mirrored(camera: Camera, board: Board, corners: FloatArray) -> list[FloatArray]:
    """As a mirrored image may number them: from the other end of the rows, or of the columns."""
    grid = ([camera.width - 1, 0] + corners * [-1, 1]).reshape(board.rows, board.columns, 2)
    return [grid[:, ::-1].reshape(-1, 2), grid[::-1].reshape(-1, 2)]


def _upside_down(camera: Camera, board: Board, corners: FloatArray) -> list[FloatArray]:
    return [[camera.width - 1, camera.height - 1] - corners]


_Undo = Callable[[Camera, Board, FloatArray], list[FloatArray]]
_SWITCH_OFF = "switch the mirroring of the {}camera{} driver off, and record again"
#: What may have happened to the images; what undoes it on the corners (M, 2) of the left and the right image, px (None:
#: nothing), with the possible numberings; and the cure.
_MISTAKES: Mapping[str, tuple[_Undo | None, _Undo | None, str]] = {
    _EXCHANGED: (
        None,
        None,
        "exchange cameras.left.image and cameras.right.image in rig.yaml, or connect the cameras the other way round; "
        "if you exchanged both images and camera infos before, exchange the camera infos alone",
    ),
    "the images of both cameras are mirrored": (_mirrored, _mirrored, _SWITCH_OFF.format("", "")),
    "the images of the left camera are mirrored": (_mirrored, None, _SWITCH_OFF.format("left ", "'s")),
    "the images of the right camera are mirrored": (None, _mirrored, _SWITCH_OFF.format("right ", "'s")),
    "the images of both cameras are upside down": (
        _upside_down,
        _upside_down,
        "calibrate the stereo pair with images as recorded, or switch the rotation of the camera driver off",
    ),
}


def _undone_px(rig: CameraRig, board: Board, mistake: str, pairs: Sequence[Pair]) -> float:
    """Median distance from the epipolar lines with a mistake undone, px rms."""
    undo = _MISTAKES[mistake][:2]
    apart_px = []
    for pair in pairs:
        images = reversed(pair) if mistake == _EXCHANGED else pair
        left, right = (
            [image.pixels] if change is None else change(camera, board, image.pixels)
            for change, camera, image in zip(undo, rig.each, images, strict=True)
        )
        apart_px.append(min(_misfit_px(rig, board, *option, pair) for option in product(left, right)))
    return float(np.median(apart_px))


def _misfit_px(rig: CameraRig, board: Board, left: FloatArray, right: FloatArray, pair: Pair) -> float:
    """Distance of the corners of one stereo pair from their epipolar lines, px rms."""
    views = [Corners(at, 1.0, 1, of.seen) for at, of in zip((left, right), pair, strict=True)]
    points, _ = best_fit(rig, views, board)
    return points.rms_px if isinstance(points, StereoPoints) else np.inf


def _check_repeated(pairs: Sequence[Pair]) -> None:
    """Refuse images that are those of the other camera, or always the same."""
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
    triangulated = [m.points for m in measured if isinstance(m, Measured) and m.points is not None]
    refused = sum(isinstance(m, Rejection) and m.reason == Reason.INCONSISTENT for m in measured)
    gross = refused + sum(points.rms_px > _GROSS_PX for points in triangulated)
    total = refused + len(triangulated)
    if gross < _FEWEST or 2 * gross < total:
        return
    misfits_px = {mistake: _undone_px(rig, board, mistake, pairs) for mistake in _MISTAKES}
    for by, mistake in ((1, _LATE), (-1, _EARLY)):
        shifted = [(a, b) for (a, _), (_, b) in pairwise(pairs[::by])]
        apart_px = [_misfit_px(rig, board, a.pixels, b.pixels, (a, b)) for a, b in shifted]
        misfits_px[mistake] = float(np.median(apart_px)) if apart_px else np.inf
    likely = min(misfits_px, key=lambda mistake: misfits_px[mistake])
    facts = (
        f"at {gross} of {total} stations, corners are behind a camera, or more than {_GROSS_PX:g} px from "
        "their epipolar lines"
    )
    in_part = gross < _NEARLY_ALL * total
    if misfits_px[likely] <= _EPIPOLAR_PX:
        cure = _MISTAKES[likely][2] if likely in _MISTAKES else _CLOCK
        raise ObservationError(
            f"{likely}: {facts}; with this undone, they are {misfits_px[likely]:.1f} px away",
            _IN_PART if in_part else cure,
        )
    raise ObservationError(
        f"camera_info does not fit the images: {facts}", _IN_PART if in_part else _RECALIBRATE
    )


def check_square(measured: Sequence[Measured | Rejection], square_m: float) -> None:
    """Compare the stated side of a square with the stereo pair's.

    Raises:
        ObservationError: they differ at the median of enough stations; names a unit given as meters.
    """
    stations = [each for each in measured if isinstance(each, Measured) and each.points is not None]
    if len(stations) >= _FEWEST and (error := square_error(square_m, stations)) is not None:
        raise error


def square_error(
    square_m: float, stations: Sequence[Measured], farther: float = 1.0
) -> ObservationError | None:
    """The error if the median side of a square by a stereo pair, m, is not the stated one.

    The limit grows with the distance of the board: it is the one of boards that are so many times `farther`.
    """
    side_m = float(np.median([station.square_m for station in stations]))
    limit = farther * float(np.median([station.square_tolerance for station in stations]))
    if abs(side_m - square_m) <= limit * square_m:
        return None
    return ObservationError(
        f"the squares are {side_m:.3g} m wide at the median of {len(stations)} measurements, but board.square_m is "
        f"{square_m:g} m (limit {100 * limit:.3g} %)",
        square_cure(square_m, side_m),
    )


def square_cure(square_m: float, side_m: float) -> str:
    """What to do about squares that do not have their stated side, m, but another one, m."""
    for unit, per_meter in _UNITS.items():
        if abs(square_m / per_meter - side_m) <= _UNIT_TOLERANCE * side_m:
            return (
                f"{square_m:g} looks like {unit}: set board.square_m to {square_m / per_meter:.4g} (meters)"
            )
    return "correct board.square_m, or calibrate the stereo pair again (camera_info)"
