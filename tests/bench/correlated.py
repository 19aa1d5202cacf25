"""Floors and wheel errors that stay the same for a while: are the standard deviations true at any picture rate?"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mobilecal_cli.model.solution import Noise
from tests.bench.imperfect import (
    AS_PRINTED,
    CORRELATED,
    LEVELS,
    USUAL,
    Case,
    Run,
    level_counts,
    print_cases,
    summary,
)
from tests.bench.study import Study, rms

RUNS = 100
RECORDINGS = {
    "20 stations": Case(stations=20),
    "80 stations": Case(stations=80),
    "80 images in motion": Case(motion="moving", images=80),
    "400 images in motion": Case(motion="moving", images=400),
    "900 images in motion": Case(motion="moving", images=900),
}
#: Number of images in motion → runs, as a share of the asked number.
SHARES = {400: 0.3, 900: 0.1}
_SEEDS = 100  # of ten routes
_WORTH_A_LINE = 3.0  # NEES / 9
#: Correlation length of the floor and distance over which a wheel's scale error is constant, m. The floor is smooth: not
#: the exponential process that the estimator assumes.
CASES = {
    (name, f"{floor_m:g}, {wheel_m:g}"): case.drawn(
        noise=replace(
            CORRELATED,
            floor_length_m=floor_m,
            wheel_length_m=wheel_m,
            **{level: Noise.limits("guess")[level] for level in ("sway_rad", "sway_m")},
        ),
        outside=AS_PRINTED,
    )
    for name, case in RECORDINGS.items()
    for floor_m, wheel_m in ((0.1, 0.3), (0.3, 1.0), (1.0, 3.0))
}
#: On a floor on which the robot stands as before where it comes back to a place; the length is that of its heights.
CASES |= {
    (f"{robot}, {name}", f"place {floor_m:g}, 1"): replace(RECORDINGS[name], robot=robot).drawn(
        noise=replace(USUAL, floor_place_m=floor_m, wheel_length_m=1.0), outside=AS_PRINTED
    )
    for robot in ("pan-tilt", "pair on the base")
    for name in ("20 stations", "80 images in motion")
    for floor_m in (0.5, 1.0, 2.0)
}


def seeds_of(case: Case, runs: int) -> list[int]:
    """Seeds of one case, spread over all routes: recordings with many images take long, so they are fewer."""
    count = max(round(SHARES.get(case.images, 1.0) * runs), 1)
    return [k * max(_SEEDS // count, 1) for k in range(count)]


def figures(runs: Sequence[Run], case: Case) -> list[object]:
    """Cells of one case."""
    error, std, nees = (np.array([getattr(r, of) for r in runs]) for of in ("error", "std", "nees"))
    ratio = rms(error / std)
    return [
        len(runs),
        f"{np.nanmean(nees[:, 3]):.2f}",
        f"{np.sqrt(np.nanmean(ratio**2)):.2f} ({np.nanmax(ratio):.2f})",
        *level_counts(runs),
        sum(r.false_pass for r in runs),
        *summary(std, case),
        f"{np.mean([r.seconds for r in runs]):.1f}",
    ]


def main(asked: Study) -> None:
    """All cells; fewer runs for many images."""
    print_cases(
        asked,
        CASES,
        ("", "floor, wheels (m)", "runs", "mean NEES / 9", "rms error over sigma (worst of nine)", *LEVELS, "false PASS",
         "sigma: rotation (deg)", "translation (mm)", "wheels (%)", "processor time (s)"),
        figures,
        "Every constant is drawn from its prior, noise levels are estimated.",
        lambda run: run.level != "PASS" or run.false_pass or run.nees[3] > _WORTH_A_LINE,
        lambda case: seeds_of(case, asked.runs),
    )  # fmt: skip
