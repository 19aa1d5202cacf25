"""Used robots: every constant drawn from three and five times its prior. Are the standard deviations still true?"""

import numpy as np

from tests.bench.drawn import CASES
from tests.bench.imperfect import USUAL, VERDICTS, print_cases, verdict_cells
from tests.bench.study import Study

RUNS = 100
USED = {
    (name, f"{scale:g}"): case.drawn(scale, noise=USUAL)
    for name, case in CASES.items()
    for scale in (3.0, 5.0)
}


def main(asked: Study) -> None:
    """All cases, noise levels estimated."""
    print_cases(
        asked,
        USED,
        ("", "times the prior", *VERDICTS, "contradictions, mean"),
        lambda runs, _: [*verdict_cells(runs), f"{np.mean([len(r.named) for r in runs]):.1f}"],
    )
