"""`make studies`: the accuracy studies of docs/explanation/results.md, in sequence; this takes hours."""

from tests.bench import degenerate, fleet, memory, monte_carlo, moving, real_pairs, robust, samples, table1

for study in (table1, samples, fleet, memory, degenerate, moving, monte_carlo, robust, real_pairs):
    print(f"\n## {study.__name__.rpartition('.')[2]}: {study.__doc__}")
    study.main()
