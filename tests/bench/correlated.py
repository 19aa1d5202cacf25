"""Floors and wheel errors that stay the same for a while: are the standard deviations true at any picture rate?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.model import Noise
from tests.bench.imperfect import (
    AS_PRINTED,
    CORRELATED,
    LEVELS,
    ROBOTS,
    USUAL,
    Case,
    Run,
    level_counts,
    print_runs,
    run_of_case,
    summary,
)
from tests.bench.study import Study, head, line, results_of, rms

#: Correlation length of the floor and distance over which a wheel's scale error is constant, m.
LENGTHS = ((0.1, 0.3), (0.3, 1.0), (1.0, 3.0))
#: Recording → case and runs, as a share of the asked number.
RECORDINGS = {
    "20 stations": (Case(stations=20), 1.0),
    "80 stations": (Case(stations=80), 1.0),
    "80 images in motion": (Case(motion="moving", images=80), 1.0),
    "400 images in motion": (Case(motion="moving", images=400), 0.3),
    "900 images in motion": (Case(motion="moving", images=900), 0.1),
}
#: The same on a floor that is a function of the place: recording → case. Its length is that of the floor's heights.
OF_PLACE = {
    f"{robot}, {name}": replace(RECORDINGS[name][0], robot=robot)
    for robot in ("pan-tilt", "pair on the base")
    for name in ("20 stations", "80 images in motion")
}
PLACE_LENGTHS = (0.5, 1.0, 2.0)
_SEEDS = 100  # of ten routes; fewer runs are spread over them
_WORTH_A_LINE = 3.0  # NEES / 9


def correlated(name: str, floor_m: float, wheel_m: float) -> Case:
    """A recording on a smooth floor, which is not the exponential process that the estimator assumes."""
    case = RECORDINGS[name][0]
    sway = {level: Noise.limits("guess")[level] for level in ("sway_rad", "sway_m")}
    noise = replace(CORRELATED, floor_length_m=floor_m, wheel_length_m=wheel_m, **sway)
    return case.drawn(noise=noise, outside=AS_PRINTED)


def of_place(name: str, floor_m: float) -> Case:
    """A recording on a floor on which the robot stands as before where it comes back to a place."""
    noise = replace(USUAL, floor_place_m=floor_m, wheel_length_m=1.0)
    return OF_PLACE[name].drawn(noise=noise, outside=AS_PRINTED)


def one_run(name: str, floor_m: float, wheel_m: float, seed: int) -> Run:
    """Noise levels and correlation lengths estimated."""
    return run_of_case(correlated(name, floor_m, wheel_m), seed)


def one_run_of_place(name: str, floor_m: float, seed: int) -> Run:
    """The same on a floor of places."""
    return run_of_case(of_place(name, floor_m), seed)


def _remarkable(run: Run) -> bool:
    return run.level != "PASS" or run.false_pass or run.nees[3] > _WORTH_A_LINE


def main() -> None:
    """All cells; runs as an argument (100 by default; fewer for many images), then parts of names of recordings."""
    asked = Study.begun(100)
    head(
        "", "floor, wheels (m)", "runs", "mean NEES / 9", "rms error over sigma (worst of nine)", *LEVELS, "false PASS",
        "sigma: rotation (deg)", "translation (mm)", "wheels (%)", "processor time (s)",
        title="Every constant is drawn from its prior, noise levels are estimated.",
    )  # fmt: skip
    for name in asked.chosen(RECORDINGS):
        runs = max(round(RECORDINGS[name][1] * asked.runs), 1)
        seeds = [k * max(_SEEDS // runs, 1) for k in range(runs)]
        for floor_m, wheel_m in LENGTHS:
            results = results_of(one_run, name, floor_m, wheel_m, seeds=seeds)
            _print_cell(name, f"{floor_m:g}, {wheel_m:g}", "pan-tilt", results, seeds)
    for name in asked.chosen(OF_PLACE):
        for floor_m in PLACE_LENGTHS:
            seeds = list(range(asked.runs))
            results = results_of(one_run_of_place, name, floor_m, seeds=seeds)
            _print_cell(name, f"place {floor_m:g}, 1", OF_PLACE[name].robot, results, seeds)


def _print_cell(name: str, lengths: str, robot: str, results: list[Run], seeds: list[int]) -> None:
    error, std, nees = (np.array([getattr(r, of) for r in results]) for of in ("error", "std", "nees"))
    ratio = rms(error / std)
    line(
        name,
        lengths,
        len(results),
        f"{np.nanmean(nees[:, 3]):.2f}",
        f"{np.sqrt(np.nanmean(ratio**2)):.2f} ({np.nanmax(ratio):.2f})",
        *level_counts(results),
        sum(r.false_pass for r in results),
        *summary(std, ROBOTS[robot]()),
        f"{np.mean([r.seconds for r in results]):.1f}",
    )
    print_runs(results, _remarkable, seeds)


if __name__ == "__main__":
    main()
