"""`make bench`: every study, one after the other."""

from tests.bench import degenerate, established, fleet, memory, monte_carlo, moving, robust, samples, table1

for study in (table1, samples, fleet, memory, established, degenerate, moving, monte_carlo, robust):
    print(f"\n## {study.__name__.rpartition('.')[2]}: {study.__doc__}")
    study.main()
