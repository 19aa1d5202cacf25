"""`make studies`: the accuracy studies of docs/validation/results.md, in sequence; this takes hours."""

from tests.bench import (
    configurations,
    correlated,
    degenerate,
    drawn,
    fleet,
    invariance,
    jumps,
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
    wheels_alone,
)


def main() -> None:
    """All of them."""
    exact = (degenerate, moving, monte_carlo, robust)  # robots exactly as described
    stay = (correlated, one_thing, jumps, invariance)
    first = (table1, samples, fleet, memory, real_pairs, drawn, configurations, used, odometry, wheels_alone)
    for study in (*first, *stay, *exact):
        print(f"\n## {study.__name__.rpartition('.')[2]}: {study.__doc__}")
        study.main()


if __name__ == "__main__":
    main()
