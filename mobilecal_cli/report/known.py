"""Criteria on the maximum-likelihood estimate: observability, noise, outliers, scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mobilecal_cli.model import NINE, Extraction, HeadChain, NoiseLevels, Solution
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, graded
from mobilecal_cli.report.outliers import noisy_sentence

# Stated square size against the stereo measurement; a difference scales all lengths.
SQUARE_LOOK, SQUARE_BAD = 0.01, 0.03
# Share of outliers that a robust estimate tolerates. Noise levels that only a defective robot has.
LEFT_OUT_BAD, JOINT_NOISE_BAD_DEG, JOINT_NOISE_BAD_MM, WHEEL_NOISE_BAD = 0.3, 0.4, 0.7, 0.03
# The estimate allows for these, so that the limits are wide: beyond the first one the robot needs a look.
FLOOR_DEG, STAMP_MS, WHEEL_SHARE_PERCENT = (0.3, 1.5), (2.0, 20.0), (1.0, 5.0)


def unobservable(solution: Solution, *, enough: bool) -> Iterator[Check]:
    """Parameters that the recording does not determine, and the motion that would.

    Args:
        solution: the solution.
        enough: whether all expected errors are within their limits all the same.
    """
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
        "look" if enough else "short",
        f"The recording does not determine {', '.join(fixed)}. The nominal value is kept, with its own uncertainty.",
        f"Record again and {'; '.join(cures)}.",
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
    if solution.noisy:
        yield Check(
            "outliers that are noise",
            ", ".join(solution.noisy),
            "none",
            "look",
            noisy_sentence(solution.noisy),
            "See the noise levels in the report.",
        )
    yield from _noise(found.noise, extraction)


def _noise(noise: NoiseLevels, extraction: Extraction) -> Iterator[Check]:
    chain = extraction.rig.chain
    joints, joints_unit, joints_bad = float(np.degrees(noise.joint_rad)), "degrees", JOINT_NOISE_BAD_DEG
    if _slides(chain):
        joints, joints_unit, joints_bad = (
            1e3 * chain.joint_units[0] * noise.joint_rad,
            "mm",
            JOINT_NOISE_BAD_MM,
        )
    wheels = noise.wheel_rad_per_sqrt_rad
    moving = not all(o.at_rest for o in extraction.observations)
    for name, level, unit, limits, cause in (
        (
            "joint readings",
            joints,
            joints_unit,
            (joints_bad / 2, joints_bad),
            "the head joints for play, and the head chain in the URDF",
        ),
        (
            "wheels",
            wheels,
            "rad per sqrt(rad)",
            (WHEEL_NOISE_BAD / 2, WHEEL_NOISE_BAD),
            "the wheels for slip",
        ),
        (
            "wheels in proportion to their rotation",
            100 * noise.wheel_share,
            "%",
            WHEEL_SHARE_PERCENT,
            "the wheels for slip, the tires and the load",
        ),
        (
            "floor (roll and pitch of the base)",
            float(np.degrees(noise.floor_rad)),
            "degrees",
            FLOOR_DEG,
            "that the floor is flat and that the base does not rock",
        ),
        (
            "image time stamps",
            1e3 * noise.stamp_s if moving else 0.0,
            "ms",
            STAMP_MS,
            "that images have hardware time stamps, or stop for each image",
        ),
    ):
        look, bad = limits
        if not level:
            continue
        yield Check(
            f"noise of the {name}",
            f"{level:.2g} {unit}",
            f"under {bad:g} {unit}",
            graded(level, look, bad),
            f"The noise of the {name} is {level:.2g} {unit} (below {look:g} {unit} is usual).",
            f"Check {cause}. Then record again.",
        )


def square(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Stated square size against the stereo baseline, for methods that do not estimate both."""
    if solution.uncertainty is None and extraction.board.square_m is not None:
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
