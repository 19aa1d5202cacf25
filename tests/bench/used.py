"""Used robots: every constant drawn from three and five times its prior. Are the standard deviations still true?"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from tests.bench.drawn import CASES
from tests.bench.imperfect import USUAL, Run, all_kinds, run_of_case
from tests.bench.simulated import conditions, map_runs


def one_run(name: str, scale: float, seed: int) -> Run:
    """Noise levels estimated."""
    case = CASES[name]
    return run_of_case(replace(case, kinds=all_kinds(case.motion == "moving", scale), noise=USUAL), seed)


def main() -> None:
    """All cases; runs as an argument, 100 by default."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(conditions())
    print(
        f"\n{runs} runs each, levels estimated.\n\n"
        "| | times the prior | mean NEES / 9 | median | PASS | FAIL | NOT ENOUGH | refused | false PASS | "
        "contradictions, mean |\n" + "| --- " * 10 + "|"
    )
    for name in CASES:
        for scale in (3.0, 5.0):
            results = list(map_runs(one_run, [(name, scale, seed) for seed in range(runs)]))
            nees, levels = np.array([r.nees[3] for r in results]), [r.level for r in results]
            cells = [f"{scale:g}", f"{np.nanmean(nees):.2f}", f"{np.nanmedian(nees):.2f}"]
            cells += [str(levels.count(level)) for level in ("PASS", "FAIL", "NOT ENOUGH")]
            cells += [str(sum(level.startswith("refused") for level in levels))]
            cells += [str(sum(r.false_pass for r in results))]
            cells += [f"{np.mean([len(r.named) for r in results]):.1f}"]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
