"""Criteria on what the maximum-likelihood estimate knows: hidden numbers, sigmas, noise, outliers, scales."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mobilecal_cli.model import NINE, Extraction, Solution
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, Outcome, graded
from mobilecal_cli.report.findings import scale_sentence

# A stated square against the one that the stereo pair measures: a scale error of all nine numbers' lengths.
SQUARE_LOOK, SQUARE_BAD = 0.01, 0.03
# Bad stations and slips that an estimate survives; beyond it most may be wrong. Noise of no sound robot.
LEFT_OUT_BAD, JOINT_NOISE_BAD_DEG, WHEEL_NOISE_BAD = 0.3, 0.4, 0.03
# Sigmas: beyond the first a number is worth improving, beyond the second a ruler does as well.
SIGMA_ROTATION_DEG, SIGMA_TRANSLATION_MM, SIGMA_WHEELS = (0.3, 1.5), (6.0, 25.0), (0.01, 0.04)
STRONG_EVIDENCE = 10.0  # of the Bayesian information criterion: "very strong" by Kass and Raftery's scale


def hidden(solution: Solution) -> Iterator[Check]:
    """What the recording does not show, and the motion that would."""
    found, motion = solution.uncertainty, solution.motion
    if found is None:
        return
    seen = zip(NINE, found.observable, found.fixed, strict=True)
    held = [name for name, ok, by_user in seen if not (ok or by_user)]
    if not held:
        return
    cures = []
    if set(held) & set(NINE[:6]):
        cures.append("tilt the head up and down by 15 degrees or more between stops, and pan it")
    if set(held) & set(NINE[6:]):
        turns, drives = motion["turned_deg"] >= MIN_TURNED_DEG, motion["driven_m"] >= MIN_DRIVEN_M
        cures.append(
            "turn the base by 20 degrees or more between stops"
            if drives and not turns
            else "drive forward and back by 20 cm or more between stops"
            if turns and not drives
            else "drive and turn the base between stops"
        )
    yield Check(
        "all nine numbers are visible",
        f"held: {', '.join(held)}",
        "none held",
        "short",
        f"The recording does not show {', '.join(held)}: held at the nominal value.",
        f"Record again and {'; '.join(cures)}.",
    )


def sigmas(solution: Solution) -> Iterator[Check]:
    """Whether the standard deviations are small enough for a robot."""
    found = solution.uncertainty
    if found is None:
        return
    wheels, std = solution.parameters.wheels, found.std
    relative = std[6:] / [wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]
    for name, values, seen, limits, unit in (
        ("camera's rotation", np.degrees(std[:3]), found.observable[:3], SIGMA_ROTATION_DEG, "degrees"),
        ("camera's position", std[3:6] * 1e3, found.observable[3:6], SIGMA_TRANSLATION_MM, "mm"),
        ("wheels", relative * 100, found.observable[6:], tuple(100 * x for x in SIGMA_WHEELS), "%"),
    ):
        if not seen.any():
            continue
        worst = float(values[seen].max())
        outcome: Outcome = "short" if worst > limits[1] else "look" if worst > limits[0] else "good"
        yield Check(
            f"standard deviation of the {name}",
            f"at most {worst:.2g} {unit}",
            f"under {limits[1]:g} {unit}",
            outcome,
            f"The {name} is known to {worst:.2g} {unit} only (one standard deviation).",
            "Record again with more stops, more head movement and more turns.",
        )


def believed(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """What was left out of the estimate, and noise that no sound robot has."""
    found = solution.uncertainty
    if found is None:
        return
    gross = [o for o in solution.outliers if o.kind != "corners"]
    share = len(gross) / max(1, len(extraction.observations))
    first = gross[0].text if gross else ""
    yield Check(
        "nothing had to be left out",
        f"{len(gross)} of {len(extraction.observations)} stations and the legs between them",
        f"under {100 * LEFT_OUT_BAD:g} %",
        "bad" if share > LEFT_OUT_BAD else "look" if gross else "good",
        f"{first}" + (f" ({len(gross) - 1} more.)" if len(gross) > 1 else ""),
        "Look for the cause; the numbers rest on what is left.",
    )
    joints, wheels = float(np.degrees(found.noise.joint_rad)), found.noise.wheel_rad_per_sqrt_rad
    for name, level, unit, bad, cause in (
        ("joint readings", joints, "degrees", JOINT_NOISE_BAD_DEG, "the head's joints for play"),
        ("wheels", wheels, "rad per root of rad", WHEEL_NOISE_BAD, "the wheels for slip"),
    ):
        yield Check(
            f"noise of the {name}",
            f"{level:.2g} {unit}",
            f"under {bad:g} {unit}",
            graded(level, bad / 2, bad),
            f"The {name} are off by {level:.2g} {unit}, more than on any sound robot.",
            f"Check {cause}, and that the chain in the URDF is right; then record again.",
        )


def wanting(solution: Solution) -> Iterator[Check]:
    """Whether the recording would rather have more numbers estimated."""
    wanted = [e for e in solution.evidence if e.state == "offered" and e.bic > STRONG_EVIDENCE]
    if solution.evidence:
        names = ", ".join(e.group for e in wanted)
        yield Check(
            "the nine numbers are enough",
            f"BIC {max(e.bic for e in wanted):+.0f} for more: {names}" if wanted else "no sign of more",
            f"BIC up to {STRONG_EVIDENCE:g}",
            "look" if wanted else "good",
            f"The recording speaks for more than nine numbers: {names}.",
            f"Try --estimate {wanted[0].group}, and see the report's table." if wanted else "",
        )


def square(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """The board's stated squares against the stereo baseline."""
    scale = solution.scale
    if scale is not None:
        off = abs(scale.ratio - 1)
        yield Check(
            "squares and baseline agree",
            f"{100 * (scale.ratio - 1):+.2f} %, standard deviation {100 * scale.std:.2g} %",
            f"within four standard deviations, and {100 * SQUARE_BAD:g} %",
            "good" if not scale.apart else "bad" if off > SQUARE_BAD else "look",
            scale_sentence(scale),
            "The baseline was trusted. Measure ten squares with a ruler; if they are as stated, calibrate the "
            "stereo pair.",
        )
    elif extraction.board.square_m is not None:
        stated = extraction.board.square_m
        seen = float(np.median([o.square_m for o in extraction.observations]))
        off = seen / stated - 1
        yield Check(
            "size of a square: stereo against stated",
            f"{seen * 1e3:.2f} mm, {100 * off:+.2f} %",
            f"within {100 * SQUARE_BAD:g} % of {stated * 1e3:.2f} mm",
            graded(abs(off), SQUARE_LOOK, SQUARE_BAD),
            f"The cameras measure squares of {seen * 1e3:.2f} mm, but {stated * 1e3:.2f} mm are stated.",
            "Measure a square with a ruler; if it is as stated, the stereo baseline in camera_info is wrong.",
        )
