"""The sample recordings: jackknife against covariance, and errors against the known truth."""

from pathlib import Path

from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import solve
from tests.bench.study import DEGREES_MM, NINE_COLUMNS, Study, head, line, numbers
from tests.truth import truth_of

_LOGS = Path(__file__).resolve().parents[2] / "sample_logs"


def main(_: Study) -> None:
    """One table for each recording that determines all nine parameters."""
    for name in ("paper_robot", "tick_robot"):
        config = _LOGS / f"{name}.rig.yaml"
        extraction, _ = extract([_LOGS / f"{name}.mcap"], load_rig(config if config.exists() else None))
        solution = solve(extraction)
        found, truth = solution.uncertainty, truth_of(_LOGS / f"{name}.truth.yaml")
        assert found is not None
        error = solution.parameters.minus(truth)
        head("", *NINE_COLUMNS, title=f"### {name}")
        line("error", *numbers(error * DEGREES_MM, 3))
        line("sigma", *numbers(found.std * DEGREES_MM, 3))
        line("jackknife sigma", *numbers(found.jackknife_std * DEGREES_MM, 3))
        line("jackknife / covariance", *numbers(found.jackknife_std / found.std))
