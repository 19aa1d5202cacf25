"""Recordings that cannot be solved: too few stations, or too little motion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import numpy as np

from mobilecal_cli.errors import MobilecalError, ObservationError, SolveError, noting
from mobilecal_cli.kinematics import FEWEST_LEGS, unseen_height
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.signals import CLOCKS_DIFFER, Reason
from mobilecal_cli.report.motion import Gap, motion_gaps, nearer
from mobilecal_cli.stations import FROZEN, NO_READINGS
from mobilecal_cli.vision import readable_words

FEWEST_STATIONS = FEWEST_LEGS + 1  # in one recording


def require_stations(extraction: Extraction) -> None:
    """Refuse an extraction with too few stations, or too few legs between consecutive stations of one recording.

    Raises:
        ObservationError: fewer than four stations or three legs; gives the numbers, and the rejections by reason.
    """
    have = len(extraction.observations)
    logs = len({o.log for o in extraction.observations})
    if have >= FEWEST_STATIONS and have - logs >= FEWEST_LEGS:
        return
    reasons = Counter((item.stage, item.reason) for item in extraction.rejections).most_common()
    counted = ", ".join(f"{n} x {reason}" for (_, reason), n in reasons)
    rejected = f"; rejected: {counted}" if counted else ""
    looked_at = extraction.counts.get("stations", have)
    where = f"poses of {have} stations"
    if not extraction.measured:
        where = f"the board was found at {have} of {looked_at} stations"
    stage, reason = reasons[0][0] if reasons else ("", "")
    what_helps = _more_stations(extraction, reason, have < looked_at and stage != "stations")
    if have < FEWEST_STATIONS:
        raise ObservationError(f"{where} (at least {FEWEST_STATIONS} needed){rejected}", what_helps)
    raise ObservationError(
        f"{where} in {logs} recordings: only {have - logs} legs join consecutive stations of one recording "
        f"(at least {FEWEST_LEGS} needed){rejected}",
        f"record more stations in each recording; {what_helps}",
    )


def _more_stations(extraction: Extraction, reason: str, without_board: bool) -> str:
    """What to do about too few stations, the likeliest cause first; images may lack the board."""
    have = len(extraction.observations)
    board, rejections = extraction.board, extraction.rejections
    if extraction.measured:
        return "give poses at more places in front of the target"
    if reason == Reason.SQUARES_UNKNOWN:
        alone = "set board.square_m in rig.yaml, or with --set: stations that one camera alone shows need it"
        return noting(alone, extraction.first_notes)
    if reason == Reason.SECOND_BOARD:
        return "cover or remove the other checkerboard: only one may be in view"
    sides = [track.value for log in extraction.wheels for track in (log.right, log.left)]
    if sides and all(np.ptp(value) == 0 for value in sides if len(value)):
        return (
            "the readings of both wheels never change: record the driver of the wheels while the base moves"
        )
    if closer := nearer(extraction):
        return closer
    if reason == Reason.OTHER_MARKERS:
        said = next(item.detail for item in rejections if item.reason == reason)
        said = said.partition("(")[2].partition(")")[0] or said
        return f"correct the board in rig.yaml (columns, rows, dictionary, first_id, gap_share): {said}"
    if reason in (Reason.LARGER, Reason.OTHER_SIZE):
        return (
            f"set the number of the board's inner corners with --board: {board.columns} x {board.rows} was used; keep "
            "other checkerboards out of view"
        )
    if have < FEWEST_STATIONS <= have + sum(item.reason == Reason.AMBIGUOUS for item in rejections):
        return (
            "use a board of which one number of inner corners is even and the other odd, such as 9 x 6, or one with "
            "markers; or stand the board upright"
        )
    if not without_board:
        of_reason = {
            NO_READINGS: "check that joints and wheels are recorded as long as the images, with stamps of one clock",
            FROZEN: "check the driver and the cable of the camera whose images do not change",
        }.get(reason, "stop at more places in front of the board")
        return noting(of_reason, extraction.first_notes)
    return (
        f"keep the whole board in {extraction.rig.cameras.images_words}, at rest, in good light, with "
        f"{readable_words(board)}; where the robot hardly rests in front of it, use --stations all"
    )


def require_observable(extraction: Extraction) -> None:
    """Refuse an extraction with unobservable parameters, for methods that do not use nominal values.

    Raises:
        SolveError: names the unobservable parameters and the missing motion.
    """
    gaps = motion_gaps(extraction)
    if unseen_height(extraction.rig.chain) is not None:
        because = "no joint of the head tilts the camera"
        cure = "use --method ml, which takes it as described"
        gaps = (Gap(("height of the camera",), because, cure, ()), *gaps)
    if gaps:
        raise SolveError(
            "; ".join(f"unobservable: {', '.join(g.parameters)}, because {g.because}" for g in gaps),
            "; ".join(g.cure for g in gaps),
        )


@contextmanager
def clocks_noted(notes: Iterable[str]) -> Iterator[None]:
    """End the hint of an error with the note on clocks that differ, if there is one: they may be its cause."""
    with causes_noted(note for note in notes if note.startswith(CLOCKS_DIFFER)):
        yield


@contextmanager
def causes_noted(notes: Iterable[str]) -> Iterator[None]:
    """End the hint of an error with notes that may be its cause."""
    try:
        yield
    except MobilecalError as error:
        error.hint = noting(error.hint, (note for note in notes if note not in error.hint))
        raise
