"""Parts of the reprojection error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.report.decomposition import error_parts
from mobilecal_cli.report.numbers import std_text
from mobilecal_cli.solvers import solve
from tests.extractions import Noise
from tests.report.example import drawn, made, recorded

QUIET = Noise(pixel_px=0.02, wheel_rad_per_sqrt_rad=1e-5, joint_rad=1e-6)


@pytest.mark.parametrize(
    ("part", "noise"),
    [
        ("floor", replace(QUIET, floor_rad=np.radians(0.3))),
        ("joints", replace(QUIET, joint_rad=np.radians(0.2))),
        ("wheels", replace(QUIET, wheel_rad_per_sqrt_rad=0.01)),
    ],
)
def test_one_noise_alone_makes_the_reprojection_error(part, noise):
    """With true levels, the prediction for one noise is the error that it makes."""
    extraction = recorded({}, noise, stations=40)
    solution = solve(extraction, "lm")
    levels = {name: getattr(noise, name) for name in ("pixel_px", "wheel_rad_per_sqrt_rad", "joint_rad")}
    levels |= {"floor_rad": noise.floor_rad, "floor_m": 0.0, "wheel_share": 0.0}
    uncertainty = drawn()[0].uncertainty
    true = replace(uncertainty, noise=replace(uncertainty.noise, **levels))
    known = replace(solution, uncertainty=true)
    parts = error_parts(known, extraction)
    assert max(parts, key=lambda name: parts[name].px) == part
    whole = np.sqrt(sum(p.px**2 for p in parts.values()))
    assert solution.reprojection_rms_px == pytest.approx(whole, rel=0.25)
    assert f"together {std_text(whole)} px" in made(known, extraction).quality.reprojection_text


def test_a_small_corner_noise_is_not_rounded_to_zero():
    solution, extraction = drawn()
    noise = replace(solution.uncertainty.noise, pixel_px=0.0041)
    quiet = replace(solution, uncertainty=replace(solution.uncertainty, noise=noise))
    assert "has a noise of 0.0041 px" in made(quiet, extraction).quality.reprojection_text
