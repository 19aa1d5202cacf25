"""The sample recordings: jackknife against covariance, and errors against the known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from mobilecal_cli import se3
from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.model import Parameters, WheelGeometry
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import solve
from tests.bench.study import DEGREES_MM, NINE_COLUMNS, conditions, head, line, numbers

_LOGS = Path(__file__).resolve().parents[2] / "sample_logs"


def _truth(path: Path) -> Parameters:
    data = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    head_eye, wheels = data["head_eye"], data["wheels"]
    rotation = se3.from_quaternion_xyzw(np.array(head_eye["quaternion_xyzw"]))
    sizes = WheelGeometry(wheels["radius_right_m"], wheels["radius_left_m"], wheels["separation_m"])
    return Parameters(se3.transform(rotation, np.array(head_eye["translation_m"])), sizes)


def main() -> None:
    """One table for each recording that determines all nine parameters."""
    print(conditions())
    for name in ("paper_robot", "tick_robot"):
        config = _LOGS / f"{name}.rig.yaml"
        extraction, _ = extract([_LOGS / f"{name}.mcap"], load_rig(config if config.exists() else None))
        solution = solve(extraction)
        found, truth = solution.uncertainty, _truth(_LOGS / f"{name}.truth.yaml")
        assert found is not None
        error = solution.parameters.minus(truth)
        head("", *NINE_COLUMNS, title=f"### {name}")
        line("error", *numbers(error * DEGREES_MM, 3))
        line("sigma", *numbers(found.std * DEGREES_MM, 3))
        line("jackknife sigma", *numbers(found.jackknife_std * DEGREES_MM, 3))
        line("jackknife / covariance", *numbers(found.jackknife_std / found.std))


if __name__ == "__main__":
    main()
