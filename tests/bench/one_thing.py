"""One thing at a time is not as described: errors, standard deviations, verdicts, and whether the cause is named."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tests.actual import PRIORS
from tests.bench.imperfect import (
    LEVELS,
    PERFECT,
    USUAL,
    Case,
    Run,
    all_kinds,
    level_counts,
    print_cases,
    summary,
)
from tests.bench.study import Study, numbers
from tests.extractions import STATION_NOISE, Outside

RUNS = 100
_DEGREE = float(np.radians(1.0))
_FLOOR = {"floor_rad": float(np.radians(0.05)), "floor_m": 0.0005}
_STEREO = {f"stereo_r_{axis}": float(np.radians(0.02)) for axis in "xyz"}
_POINTS = {f"principal_{side}_{axis}": 2 / 640 for side in ("left", "right") for axis in "xy"}
#: What is not as described.
CASES = {
    "nothing": Case(),
    "stereo rotation 0.02 deg": Case(fixed=_STEREO),
    "baseline 0.3 %": Case(fixed={"baseline_scale": 0.003}),
    "focal lengths 0.3 %": Case(fixed={"focal_left": 0.003, "focal_right": 0.003}),
    "principal points 2 px": Case(fixed=_POINTS),
    "joint axes 0.1 deg": Case(kinds={"joint_axis": 1.0}),
    "floor 0.05 deg and 0.5 mm": Case(noise=replace(PERFECT, **_FLOOR)),
}
_LENGTHS = ("square_size", "baseline_length")  # both measure the scale
for _kind in PRIORS:
    if _kind == "clock":
        continue
    _case = Case(motion="moving" if _kind in ("stereo_clock", "readout") else "standard")
    _same = _LENGTHS if _kind in _LENGTHS else (_kind,)
    CASES[f"{_kind}, 1 prior sigma"] = replace(_case, kinds={_kind: 1.0})
    CASES[f"{_kind}, 5 prior sigma"] = replace(_case, kinds={_kind: 5.0}, right=_same)
for _scale in (1.0, 5.0):
    _guess = {name: _scale * getattr(STATION_NOISE, name) for name in STATION_NOISE.__slots__}
    _floor, _share, _stamps = (
        replace(PERFECT, **{name: _guess[name] for name in names})
        for names in (("floor_rad", "floor_m"), ("wheel_share",), ("stamp_s",))
    )
    CASES[f"floor, {_scale:g} times the guess"] = Case(noise=_floor)
    CASES[f"wheels in proportion, {_scale:g} times the guess"] = Case(noise=_share)
    CASES[f"stamps in motion, {_scale:g} times the guess"] = Case(motion="moving", noise=_stamps)
CASES |= {
    "outside: heavy-tailed wheel noise": Case(outside=Outside(heavy_tails=True)),
    "outside: sag of 0.1 deg with tilt": Case(outside=Outside(sag_rad=0.1 * _DEGREE)),
    "outside: tilt play of 0.1 deg by gravity": Case(outside=Outside(gravity_play_rad=0.1 * _DEGREE)),
}

_ROUGH = replace(PERFECT, floor_rad=STATION_NOISE.floor_rad, floor_m=STATION_NOISE.floor_m, floor_smooth=True)
_WHILE = replace(_ROUGH, floor_length_m=0.3, wheel_share=STATION_NOISE.wheel_share, wheel_length_m=0.45)
_LEANING = {"lean_roll": 0.1 * _DEGREE, "lean_pitch": 0.1 * _DEGREE}
_MILD = Case(
    kinds=all_kinds(moving=False, scale=0.4),
    fixed={"board_twist": 0.001, "board_bend_x": 0.001},
    noise=replace(USUAL, encoder_step_rad=2 * np.pi / 4096, floor_length_m=0.3, wheel_length_m=1.0),
    outside=Outside(sheet_m=0.0003),
    right=("board_bend", "board_corners"),
)
_PRINT, _LENS = Outside(print_m=0.00015), Outside(lens_px=0.1)
_MOVING = Case(motion="moving")
_STAYS = {"floor smooth over 1 m": Case(noise=replace(_ROUGH, floor_length_m=1.0))}
for _images in (80, 400):
    _name = f"floor over 0.3 m, wheels over 0.45 m, {_images} images"
    _STAYS[_name] = replace(_MOVING, images=_images, noise=_WHILE)
for _mm in (0.5, 1, 3):
    _STAYS[f"board twisted by {_mm:g} mm"] = Case(fixed={"board_twist": 1e-3 * _mm}, right=("board_bend",))
_STAYS |= {
    "board sheared by 0.1 deg": Case(fixed={"board_shear": 0.1 * _DEGREE}, right=("board_shear",)),
    "base leans by 0.1 deg in roll and pitch": Case(fixed=_LEANING, right=("lean",)),
}
for _n in (20, 200):
    _name = f"print errors of 0.15 mm, {_n} stations"
    _STAYS[_name] = Case(stations=_n, outside=_PRINT, right=("board_corners",))
for _robot in ("pan-tilt", "pair on the base", "camera on the base"):
    _lens = Case(robot=_robot, stations=40, outside=_LENS, right=("lens_waves",))
    _STAYS[f"lens waves of 0.1 px, {_robot}"] = _lens
_STAYS |= {
    "mild everything, twist and bend 1 mm, two sheets 0.3 mm apart": _MILD,
    "every image twice": Case(twice=True),
    "right camera 3 ms late, moving": replace(_MOVING, fixed={"time_right": 0.003}, right=("stereo_clock",)),
    "right camera's time varies by 1 ms, moving": replace(_MOVING, noise=replace(PERFECT, pair_s=0.001)),
    "rolling shutter of 10 ms, moving": replace(_MOVING, fixed={"readout": 0.01}, right=("readout",)),
}
CASES |= {f"stays: {name}": case for name, case in _STAYS.items()}


def figures(runs: Sequence[Run], case: Case) -> list[object]:
    """Cells of one case."""
    named, right = [r.named for r in runs if r.named], case.right
    return [
        *summary(np.array([r.error for r in runs]), case),
        *numbers(np.nanmedian(np.array([r.nees[:3] for r in runs]), axis=0)),
        *level_counts(runs),
        sum(r.beyond for r in runs),
        sum(r.false_pass for r in runs),
        f"{sum(kinds[0] in right for kinds in named)} of {len(named)}" if right else "-",
        sum(bool(set(kinds) - set(right)) for kinds in named),
        sum(bool(r.jumps) for r in runs),
    ]


def main(asked: Study) -> None:
    """All cases, noise levels estimated."""
    print_cases(
        asked,
        {(name,): case for name, case in CASES.items()},
        ("not as described", "rotation (deg)", "translation (mm)", "wheels (%)", "median NEES / 3: rotation", "translation",
         "wheels", *LEVELS, "beyond five sigmas", "false PASS", "named first, of runs with a contradiction",
         "other causes named", "changes named"),
        figures,
        f"{asked.runs} runs each, 20 stations or 40 images in motion, pan-tilt robot; all else as described.",
        lambda r: bool(r.beyond or r.jumps or r.level != "PASS"),
    )  # fmt: skip
