"""Figures of good and insufficient motion from the samples: `docs/generate/motions.py` writes docs/images/."""

from __future__ import annotations

import tempfile
from pathlib import Path

from mobilecal_cli.calibrate import steps
from mobilecal_cli.report import plots
from mobilecal_cli.report.svg import standalone
from mobilecal_cli.solvers import constraints_of

REPOSITORY = Path(__file__).resolve().parents[2]
IMAGES = REPOSITORY / "docs" / "images"
SAMPLES = REPOSITORY / "sample_logs"


def main() -> None:
    """Path and head angles of a good recording, one with straight driving only, and one with a still head."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("paper_robot", "straight", "head_fixed"):
            constraints = constraints_of(["t_y=0"] if name == "head_fixed" else [], [], [])
            report = steps.calibrate([SAMPLES / f"{name}.mcap"], Path(folder) / name, constraints=constraints)
            done = report.fit
            way = plots.path_picture(done.solution, done.extraction)
            (IMAGES / f"way-{name}.svg").write_text(standalone(way.svg), encoding="utf-8")
            (head,) = plots.head_angles(done.solution, done.extraction)
            (IMAGES / f"head-{name}.svg").write_text(standalone(head.svg), encoding="utf-8")


if __name__ == "__main__":
    main()
