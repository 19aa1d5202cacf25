"""One thing at a time is not as described: errors, standard deviations, verdicts, and whether the cause is named."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from mobilecal_cli.simulate.route import Motion
from tests.actual import PRIORS
from tests.bench.imperfect import (
    LEVELS,
    PERFECT,
    ROBOTS,
    USUAL,
    Case,
    Run,
    all_kinds,
    level_counts,
    print_runs,
    run_of_case,
    summary,
)
from tests.bench.study import Study, head, line, numbers, results_of
from tests.extractions import STATION_NOISE, Outside

_DEGREE = float(np.radians(1.0))
_FLOOR = {"floor_rad": float(np.radians(0.05)), "floor_m": 0.0005}
_STEREO = {f"stereo_r_{axis}": float(np.radians(0.02)) for axis in "xyz"}
_POINTS = {f"principal_{side}_{axis}": 2 / 640 for side in ("left", "right") for axis in "xy"}
#: Name → what is not as described, and the kinds that are a right answer to "what is wrong?".
CASES: dict[str, tuple[Case, tuple[str, ...]]] = {"nothing": (Case(), ())}
CASES |= {
    "stereo rotation 0.02 deg": (Case(fixed=_STEREO), ()),
    "baseline 0.3 %": (Case(fixed={"baseline_scale": 0.003}), ()),
    "focal lengths 0.3 %": (Case(fixed={"focal_left": 0.003, "focal_right": 0.003}), ()),
    "principal points 2 px": (Case(fixed=_POINTS), ()),
    "joint axes 0.1 deg": (Case(kinds={"joint_axis": 1.0}), ()),
    "floor 0.05 deg and 0.5 mm": (Case(noise=replace(PERFECT, **_FLOOR)), ()),
}
_LENGTHS = ("square_size", "baseline_length")
for _kind in PRIORS:
    _motion: Motion = "moving" if _kind in ("stereo_clock", "readout") else "standard"
    _same = _LENGTHS if _kind in _LENGTHS else (_kind,)
    if _kind != "clock":
        for _scale, _right in ((1.0, ()), (5.0, _same)):
            _case = Case(motion=_motion, kinds={_kind: _scale})
            CASES[f"{_kind}, {_scale:g} prior sigma"] = (_case, _right)
for _scale in (1.0, 5.0):
    _floor = {name: _scale * getattr(STATION_NOISE, name) for name in ("floor_rad", "floor_m")}
    CASES[f"floor, {_scale:g} times the guess"] = (Case(noise=replace(PERFECT, **_floor)), ())
    _share = {"wheel_share": _scale * STATION_NOISE.wheel_share}
    CASES[f"wheels in proportion, {_scale:g} times the guess"] = (Case(noise=replace(PERFECT, **_share)), ())
    _stamps = replace(PERFECT, stamp_s=_scale * STATION_NOISE.stamp_s)
    CASES[f"stamps in motion, {_scale:g} times the guess"] = (Case(motion="moving", noise=_stamps), ())
CASES |= {
    "outside: heavy-tailed wheel noise": (Case(outside=Outside(heavy_tails=True)), ()),
    "outside: sag of 0.1 deg with tilt": (Case(outside=Outside(sag_rad=0.1 * _DEGREE)), ()),
    "outside: tilt play of 0.1 deg by gravity": (Case(outside=Outside(gravity_play_rad=0.1 * _DEGREE)), ()),
}

_ROUGH = replace(PERFECT, floor_rad=STATION_NOISE.floor_rad, floor_m=STATION_NOISE.floor_m, floor_smooth=True)
_WHILE = replace(_ROUGH, floor_length_m=0.3, wheel_share=STATION_NOISE.wheel_share, wheel_length_m=0.45)
_LEANING = {"lean_roll": 0.1 * _DEGREE, "lean_pitch": 0.1 * _DEGREE}
_MILD = Case(
    kinds=all_kinds(moving=False, scale=0.4),
    fixed={"board_twist": 0.001, "board_bend_x": 0.001},
    noise=replace(USUAL, encoder_step_rad=2 * np.pi / 4096, floor_length_m=0.3, wheel_length_m=1.0),
    outside=Outside(sheet_m=0.0003),
)
_SHEETS, _PRINT = "twist and bend 1 mm, two sheets 0.3 mm apart", Outside(print_m=0.00015)
_LENS = Outside(lens_px=0.1)
_moving = partial(Case, motion="moving")
CASES |= {
    f"stays: {name}": case
    for name, case in (
        ("floor smooth over 1 m", (Case(noise=replace(_ROUGH, floor_length_m=1.0)), ())),
        *(
            (
                f"floor over 0.3 m, wheels over 0.45 m, {images} images",
                (_moving(images=images, noise=_WHILE), ()),
            )
            for images in (80, 400)
        ),
        *(
            (f"board twisted by {mm:g} mm", (Case(fixed={"board_twist": 1e-3 * mm}), ("board_bend",)))
            for mm in (0.5, 1, 3)
        ),
        ("board sheared by 0.1 deg", (Case(fixed={"board_shear": 0.1 * _DEGREE}), ("board_shear",))),
        ("base leans by 0.1 deg in roll and pitch", (Case(fixed=_LEANING), ("lean",))),
        *(
            (f"print errors of 0.15 mm, {n} stations", (Case(stations=n, outside=_PRINT), ("board_corners",)))
            for n in (20, 200)
        ),
        *(
            (
                f"lens waves of 0.1 px, {robot}",
                (Case(robot=robot, stations=40, outside=_LENS), ("lens_waves",)),
            )
            for robot in ("pan-tilt", "pair on the base", "camera on the base")
        ),
        (f"mild everything, {_SHEETS}", (_MILD, ("board_bend", "board_corners"))),
        ("every image twice", (Case(twice=True), ())),
        ("right camera 3 ms late, moving", (_moving(fixed={"time_right": 0.003}), ("stereo_clock",))),
        ("rolling shutter of 10 ms, moving", (_moving(fixed={"readout": 0.01}), ("readout",))),
    )
}


def one_run(name: str, seed: int) -> Run:
    """Noise levels estimated."""
    return run_of_case(CASES[name][0], seed)


def main() -> None:
    """All cases; runs as an argument, 100 by default, then parts of names."""
    asked = Study.begun(100)
    head(
        "not as described", "rotation (deg)", "translation (mm)", "wheels (%)", "median NEES / 3: rotation", "translation",
        "wheels", *LEVELS, "beyond five sigmas", "false PASS", "named first, of runs with a contradiction",
        "other causes named", "changes named",
        title=f"{asked.runs} runs each, 20 stations or 40 images in motion, pan-tilt robot; all else as described.",
    )  # fmt: skip
    for name in asked.chosen(CASES):
        case, right = CASES[name]
        results = results_of(one_run, name, seeds=range(asked.runs))
        named = [r.named for r in results if r.named]
        line(
            name,
            *summary(np.array([r.error for r in results]), ROBOTS[case.robot]()),
            *numbers(np.nanmedian(np.array([r.nees[:3] for r in results]), axis=0)),
            *level_counts(results),
            sum(r.beyond for r in results),
            sum(r.false_pass for r in results),
            f"{sum(kinds[0] in right for kinds in named)} of {len(named)}" if right else "-",
            sum(bool(set(kinds) - set(right)) for kinds in named),
            sum(bool(r.jumps) for r in results),
        )
        print_runs(results, lambda r: bool(r.beyond or r.jumps or r.level != "PASS"))


if __name__ == "__main__":
    main()
