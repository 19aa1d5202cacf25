"""Criteria on the recording: stations, motion, camera_info, rejections, mistakes in the robot description."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mobilecal_cli.model import CAMERA_INFO_CHANGES, Extraction, Solution
from mobilecal_cli.report.check import LEAST_MOTION, Check, enough, graded
from mobilecal_cli.report.numbers import rejection_counts, stations_looked_at

# Nine unknowns need four stations; twice that gives enough redundancy to detect errors.
MIN_STATIONS = 8
REJECTED_LOOK_PERCENT = 50.0


def mistakes(solution: Solution) -> Iterator[Check]:
    """The mistake in the robot description that explains a bad fit."""
    found = solution.diagnosis
    if found is None:
        return
    before, after = (
        None if share is None else 100 * share for share in (found.error_share, found.corrected_share)
    )
    facts = {"cause": found.cause, "cure": found.cure, "corrected": after}
    yield Check("mistake", before, None, "fail", facts)


def station_checks(extraction: Extraction) -> Iterator[Check]:
    """Stations, and legs between them in several recordings."""
    have, logs = len(extraction.observations), len({o.log for o in extraction.observations})
    yield Check("stations", have, MIN_STATIONS, enough(have, MIN_STATIONS))
    if logs > 1:
        legs, least = have - logs, MIN_STATIONS - 1
        yield Check("legs", legs, least, enough(legs, least), {"logs": logs})


def motion_checks(solution: Solution) -> Iterator[Check]:
    """Motion of head and base, for methods without standard deviations."""
    for key, least in LEAST_MOTION.items():
        if key in solution.motion:
            value = solution.motion[key]
            yield Check(f"motion.{key}", value, least, enough(value, least))


def camera_info(extraction: Extraction) -> Iterator[Check]:
    """One calibration of each camera for the whole recording; the estimate uses the first."""
    changes = [note for note in extraction.notes if CAMERA_INFO_CHANGES in note]
    if changes:
        yield Check("camera_info", len(changes), 0, "warning", {"note": changes[0]})


def rejected(extraction: Extraction) -> Check:
    """Share of rejected stations."""
    found, used = stations_looked_at(extraction), len(extraction.observations)
    share, counts = 100 * (1 - used / found), rejection_counts(extraction)
    often = next(iter(counts))[1] if counts else ""
    facts = {"rejected": found - used, "found": found, "often": often}
    outcome = graded(share, REJECTED_LOOK_PERCENT, math.inf)
    return Check("rejected", share, REJECTED_LOOK_PERCENT, outcome, facts)
