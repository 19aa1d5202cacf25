"""The board in a few images spread over a recording: its size, how often it is found, and the side of its squares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mobilecal_cli.calibrate.detect import check_picture, several_sizes, undecodable
from mobilecal_cli.calibrate.extract import OF_MARKERS, other_size
from mobilecal_cli.errors import ObservationError, QualityError, RecordingError
from mobilecal_cli.model import Board, BoardView, CameraRig, GrayImage, Rejection, Sources, Station
from mobilecal_cli.readers import Recording, pictures_near
from mobilecal_cli.report.inspection import Finding
from mobilecal_cli.rig.resolve import Survey
from mobilecal_cli.vision import (
    Detection,
    Measured,
    Miss,
    find_board,
    identify_size,
    measure,
    readable_words,
    square_cure,
    square_error,
)

#: Number of moments, evenly spaced, at which an image of either camera is searched for the board.
PICTURE_MOMENTS = 6
#: Difference of the stated squares from the measured ones.
_SQUARE_PERCENT = 1.0
#: The board is at most so many times farther at the stations than in these images.
_FARTHER = 2.0


def sample_board(recording: Recording, survey: Survey) -> tuple[BoardView | None, list[Finding]]:
    """The board in a few images (None if no image can be read), and what is wrong with it.

    Args:
        survey: of a recording whose image topics are known; the board's size is found in the images if its
            configuration does not state it.
    """
    images, cameras, config = survey.sources.image, survey.cameras, survey.config
    board, stated_m = config.board.stated, config.board.square_m
    start, end = recording.start_ns, recording.end_ns
    if start is None or end is None:
        return None, []
    moments = np.linspace(start, end, PICTURE_MOMENTS + 2)[1:-1].astype(np.int64).tolist()
    sources = Sources(images, {}, {}, {}, layout=config.cameras.layout)
    samples: dict[str, list[GrayImage | Rejection]] = {name: [] for name in images}
    for name, picture in pictures_near(recording, sources, moments):
        samples[name].append(picture)
    readable = [image for some in samples.values() for image in some if not isinstance(image, Rejection)]
    if not readable:
        broken = [image for some in samples.values() for image in some if isinstance(image, Rejection)]
        none = RecordingError("the recording contains no image", "record the cameras' images")
        return None, [Finding.of("cameras", undecodable(broken) if broken else none)]
    findings: list[Finding] = []
    for name, some in samples.items() if cameras is not None else ():
        first = next((image for image in some if not isinstance(image, Rejection)), None)
        try:
            if first is not None and cameras is not None:
                check_picture(first, name, cameras)
        except RecordingError as wrong_size:
            findings.append(Finding.of("camera infos", wrong_size))
    stated, others = board, 0
    if board is None or not any(isinstance(find_board(image, board), Detection) for image in readable):
        vote = identify_size(readable)
        if vote.size is not None and board is not None:
            if board.markers is not None:
                findings.append(
                    Finding.of("board", _no_markers(len(readable), board.markers.kind, *vote.size))
                )
            elif set(vote.size) != {board.columns, board.rows}:
                findings.append(Finding.of("board", other_size(board, vote.size)))
        board = None if vote.size is None else Board(*vote.size)
        others = vote.beside + sum(n for size, n in vote.votes.items() if not _part_of(size, vote.size))
        if board is None and vote.votes:
            findings.append(Finding.of("board", several_sizes(vote)))
            return BoardView(len(readable), 0, None, other_sizes=others), findings
    if board is None:
        plain = stated is None or stated.markers is None
        what = "a whole checkerboard" if plain else "the configured board"
        what = f"{what} is in none of {len(readable)} images spread over the recording"
        where = "an image" if cameras is None else cameras.images_words
        where = "both images" if len(images) == 2 else where
        cure = f"keep the whole board in {where}, in good light, with {readable_words(stated)}"
        cure += f"; {OF_MARKERS}" if stated is None else ""
        findings.append(Finding.of("board", ObservationError(what, cure)))
        return BoardView(len(readable), 0, None, other_sizes=others), findings
    detections = {
        name: [None if isinstance(image, Rejection) else find_board(image, board) for image in some]
        for name, some in samples.items()
    }
    detected = sum(
        isinstance(detection, Detection) for of_camera in detections.values() for detection in of_camera
    )
    pairs = () if cameras is None or findings else _stereo_pairs(cameras, board, detections)
    squares_m = tuple(pair.square_m for pair in pairs)
    findings += _wrong_square(stated_m, pairs) if stated_m and pairs else []
    size = board.columns, board.rows
    return BoardView(len(readable), detected, size, squares_m, stated_m, others), findings


def _no_markers(images: int, kind: str, columns: int, rows: int) -> ObservationError:
    return ObservationError(
        f"none of {images} images shows the markers of the stated {kind} board, but a checkerboard of "
        f"{columns} x {rows} inner corners",
        "correct board.dictionary in rig.yaml, or leave out board.kind if the board has no markers",
    )


def _part_of(size: tuple[int, int], whole: tuple[int, int] | None) -> bool:
    """Whether a grid of this size can be a board that the edge of an image cuts off, or that board itself."""
    return whole is not None and size[0] <= whole[0] and size[1] <= whole[1]


def _wrong_square(stated_m: float, pairs: Sequence[Measured]) -> list[Finding]:
    """A stated size of the squares that `calibrate` refuses, or that several stereo pairs do not confirm."""
    squares_m = [pair.square_m for pair in pairs]
    mean, refused = float(np.mean(squares_m)), square_error(stated_m, pairs, _FARTHER)
    if refused is not None:
        return [Finding.of("square size", refused)]
    noise = float(np.std(squares_m, ddof=1)) / math.sqrt(len(squares_m)) if len(squares_m) > 1 else math.inf
    if abs(mean - stated_m) <= max(_SQUARE_PERCENT / 100 * stated_m, 3 * noise):
        return []
    what = f"the squares measure {mean * 1e3:.2f} mm in {len(squares_m)} stereo pairs, {stated_m * 1e3:.2f} mm are "
    what += f"stated (limit {_SQUARE_PERCENT:g} %)"
    if square_error(stated_m, pairs, 1 / _FARTHER) is not None:
        what += "; whether a calibration stops at this depends on the board's distance at its stations, not known yet"
    return [Finding("square size", "limit", what, square_cure(stated_m, mean), QualityError.exit_code)]


def _stereo_pairs(
    cameras: CameraRig, board: Board, detections: Mapping[str, Sequence[Detection | Miss | None]]
) -> tuple[Measured, ...]:
    """The board in each stereo pair that shows it."""
    if not cameras.calibrated or len(detections["left"]) != len(detections["right"]):
        return ()  # the images cannot be paired without their stamps
    pairs = []
    station = Station(0, True, (), 0, np.zeros(0), np.zeros(0))
    for left, right in zip(detections["left"], detections["right"], strict=True):
        if isinstance(left, Detection) and isinstance(right, Detection):
            measured = measure(station, [[left, right]], cameras, board)
            if isinstance(measured, Measured) and measured.points is not None:
                pairs.append(measured)
    return tuple(pairs)
