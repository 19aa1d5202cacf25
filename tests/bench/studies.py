"""`make studies`: the accuracy studies of docs/explanation/results.md, in sequence; this takes hours."""

from tests.bench import (
    degenerate,
    drawn,
    fleet,
    memory,
    monte_carlo,
    moving,
    odometry,
    one_thing,
    real_pairs,
    robust,
    samples,
    table1,
    used,
)

exact = (degenerate, moving, monte_carlo, robust)  # robots exactly as described
for study in (table1, samples, fleet, memory, real_pairs, drawn, used, odometry, one_thing, *exact):
    print(f"\n## {study.__name__.rpartition('.')[2]}: {study.__doc__}")
    study.main()
