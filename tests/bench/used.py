"""Used robots: every constant drawn from three and five times its prior. Are the standard deviations still true?"""

from __future__ import annotations

import numpy as np

from tests.bench.drawn import CASES
from tests.bench.imperfect import USUAL, VERDICTS, Run, run_of_case, verdict_cells
from tests.bench.study import Study, head, line, results_of


def one_run(name: str, scale: float, seed: int) -> Run:
    """Noise levels estimated."""
    return run_of_case(CASES[name].drawn(scale, noise=USUAL), seed)


def main() -> None:
    """All cases; runs as an argument, 100 by default."""
    asked = Study.begun(100)
    title = f"{asked.runs} runs each, levels estimated."
    head("", "times the prior", *VERDICTS, "contradictions, mean", title=title)
    for name in asked.chosen(CASES):
        for scale in (3.0, 5.0):
            results = results_of(one_run, name, scale, seeds=range(asked.runs))
            named = np.mean([len(r.named) for r in results])
            line(name, f"{scale:g}", *verdict_cells(results), f"{named:.1f}")


if __name__ == "__main__":
    main()
