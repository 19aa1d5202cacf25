"""Criteria on the maximum-likelihood estimate: observability, standard deviations, noise, outliers, scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mobilecal_cli.model import NINE, Extraction, HeadChain, Solution
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, Outcome, graded
from mobilecal_cli.report.findings import scale_sentence
from mobilecal_cli.report.numbers import std_text

# Stated square size against the stereo measurement; a difference scales all lengths.
SQUARE_LOOK, SQUARE_BAD = 0.01, 0.03
# Share of outliers that a robust estimate tolerates. Noise levels that only a defective robot has.
LEFT_OUT_BAD, JOINT_NOISE_BAD_DEG, JOINT_NOISE_BAD_MM, WHEEL_NOISE_BAD = 0.3, 0.4, 0.7, 0.03
# Standard deviations: recommended, and as inaccurate as a ruler.
SIGMA_ROTATION_DEG, SIGMA_TRANSLATION_MM, SIGMA_WHEELS = (0.3, 1.5), (6.0, 25.0), (0.01, 0.04)
STRONG_EVIDENCE = 10.0  # delta BIC, "very strong" on the scale of Kass and Raftery


def unobservable(solution: Solution) -> Iterator[Check]:
    """Parameters that the recording does not determine, and the motion that would."""
    found, motion = solution.uncertainty, solution.motion
    if found is None:
        return
    seen = zip(NINE, found.observable, found.fixed, strict=True)
    fixed = [name for name, ok, by_user in seen if not (ok or by_user)]
    if not fixed:
        return
    cures = []
    if set(fixed) & set(NINE[:6]):
        cures.append("tilt the head up and down by 15 degrees or more between stops, and pan it")
    if set(fixed) & set(NINE[6:]):
        turns, drives = motion["turned_deg"] >= MIN_TURNED_DEG, motion["driven_m"] >= MIN_DRIVEN_M
        cures.append(
            "turn the base by 20 degrees or more between stops"
            if drives and not turns
            else "drive forward and back by 20 cm or more between stops"
            if turns and not drives
            else "drive and turn the base between stops"
        )
    yield Check(
        "observable parameters",
        f"{9 - len(fixed)} of 9 (not observable: {', '.join(fixed)})",
        "9 of 9",
        "short",
        f"The recording does not determine {', '.join(fixed)}. The nominal value is kept, with its own uncertainty.",
        f"Record again and {'; '.join(cures)}.",
    )


def sigmas(solution: Solution) -> Iterator[Check]:
    """Whether the standard deviations are small enough."""
    found = solution.uncertainty
    if found is None:
        return
    wheels, std = solution.parameters.wheels, found.std
    relative = std[6:] / [wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]
    for name, values, seen, limits, unit in (
        ("camera rotation", np.degrees(std[:3]), found.observable[:3], SIGMA_ROTATION_DEG, "degrees"),
        ("camera position", std[3:6] * 1e3, found.observable[3:6], SIGMA_TRANSLATION_MM, "mm"),
        ("wheels", relative * 100, found.observable[6:], tuple(100 * x for x in SIGMA_WHEELS), "%"),
    ):
        if not seen.any():
            continue
        worst = float(values[seen].max())
        outcome: Outcome = "short" if worst > limits[1] else "look" if worst > limits[0] else "good"
        yield Check(
            f"standard deviation of the {name}",
            f"{std_text(worst)} {unit}",
            f"under {limits[1]:g} {unit}",
            outcome,
            f"The standard deviation of the {name} is {std_text(worst)} {unit} ({limits[0]:g} {unit} is good).",
            "Record again with more stops, head motion and turns.",
        )


def _slides(chain: HeadChain) -> bool:
    """Whether all joints of the head are prismatic."""
    return bool(chain.joints) and len(chain.prismatic) == len(chain.joints)


def outliers_and_noise(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Outliers, and noise levels of joints and wheels."""
    found = solution.uncertainty
    if found is None:
        return
    gross = [o for o in solution.outliers if o.kind != "corners"]
    share = len(gross) / max(1, len(extraction.observations))
    first = gross[0].text if gross else ""
    yield Check(
        "outliers",
        f"{len(gross)} in {len(extraction.observations)} stations and the legs between them",
        f"under {100 * LEFT_OUT_BAD:g} %",
        "bad" if share > LEFT_OUT_BAD else "look" if gross else "good",
        f"{first}" + (f" Further outliers: {len(gross) - 1}." if len(gross) > 1 else ""),
        "Find the cause. The result uses the remaining measurements.",
    )
    chain = extraction.rig.chain
    joints, joints_unit, joints_bad = float(np.degrees(found.noise.joint_rad)), "degrees", JOINT_NOISE_BAD_DEG
    if _slides(chain):
        joints, joints_unit, joints_bad = (
            1e3 * chain.joint_units[0] * found.noise.joint_rad,
            "mm",
            JOINT_NOISE_BAD_MM,
        )
    for name, level, unit, bad, cause in (
        ("joint readings", joints, joints_unit, joints_bad, "the head joints for play"),
        (
            "wheels",
            found.noise.wheel_rad_per_sqrt_rad,
            "rad per sqrt(rad)",
            WHEEL_NOISE_BAD,
            "the wheels for slip",
        ),
    ):
        yield Check(
            f"noise of the {name}",
            f"{level:.2g} {unit}",
            f"under {bad:g} {unit}",
            graded(level, bad / 2, bad),
            f"The noise of the {name} is {level:.2g} {unit} (below {bad / 2:g} {unit} is usual).",
            f"Check {cause}, and check the head chain in the URDF. Then record again.",
        )


def description(solution: Solution) -> Iterator[Check]:
    """Whether the data contradict the robot description."""
    for found in solution.contradictions:
        yield Check(
            f"robot description: {found.kind} of the {found.part}",
            f"{found.sigmas:.1f} sigma",
            "under 4 sigma",
            "bad" if found.shift_sigmas > 2 else "look",
            f"The {found.kind} of the {found.part} is not as stated.",
            "Calibrate it again.",
        )


def square(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Stated square size against the stereo baseline."""
    scale = solution.scale
    if scale is not None:
        off = abs(scale.ratio - 1)
        yield Check(
            "square size against stereo baseline",
            f"{100 * (scale.ratio - 1):+.2f} %, 1 sigma {100 * scale.std:.2g} %",
            f"within 4 sigma, and within {100 * SQUARE_BAD:g} %",
            "good" if not scale.apart else "bad" if off > SQUARE_BAD else "look",
            scale_sentence(scale),
            "The baseline was used. Measure ten squares with a ruler. If they are as stated, calibrate the stereo "
            "pair again.",
        )
    elif extraction.board.square_m is not None:
        stated = extraction.board.square_m
        seen = float(np.median([o.square_m for o in extraction.observations]))
        off = seen / stated - 1
        yield Check(
            "square size: stereo against stated",
            f"{seen * 1e3:.2f} mm, {100 * off:+.2f} %",
            f"within {100 * SQUARE_BAD:g} % of {stated * 1e3:.2f} mm",
            graded(abs(off), SQUARE_LOOK, SQUARE_BAD),
            f"The stereo pair measures squares of {seen * 1e3:.2f} mm, but {stated * 1e3:.2f} mm is stated.",
            "Measure a square with a ruler. If it is as stated, the stereo baseline in camera_info is wrong.",
        )
