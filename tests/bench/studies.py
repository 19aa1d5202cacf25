"""`make studies`: the studies of docs/validation/results.md, in sequence; this takes hours.

`python -m tests.bench.studies STUDY [RUNS] [PART ...]` runs one of them; of its cases, those whose names contain a part.
"""

import sys
from importlib import import_module

from tests.bench.study import Study, conditions

STUDIES = (
    *("table1", "samples", "memory", "large", "real_pairs", "wheels_alone"),
    *("drawn", "configurations", "geometry", "used", "odometry", "one_thing", "correlated", "jumps", "invariance", "physics"),
    *("degenerate", "moving", "monte_carlo", "robust"),  # robots exactly as described
)  # fmt: skip


def main() -> None:
    """The named study, or all of them; a module states its number of runs if it has one."""
    name, runs, parts = sys.argv[1:2], sys.argv[2:3], sys.argv[3:]
    for study in name or STUDIES:
        module = import_module(f"tests.bench.{study}")
        print(f"\n## {study}: {module.__doc__}\n\n{conditions()}")
        module.main(Study(int(runs[0]) if runs else getattr(module, "RUNS", 0), tuple(parts)))


if __name__ == "__main__":
    main()
