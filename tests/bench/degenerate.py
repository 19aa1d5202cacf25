"""Insufficient motion: which parameters are marked as unobservable, and do the others reach their bound?"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.model import NINE
from mobilecal_cli.simulate.ideal import ideal_extraction
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers import constraints_of, solve
from tests.bench.simulated import (
    DISTURBED,
    GIVEN,
    HEADER,
    RUNS_PER_ROUTE,
    conditions,
    errors,
    map_runs,
    route_of,
)

# Motion, and what is fixed: wheels alone with a known head-eye transform is the case of Antonelli and Chiaverini.
_CASES = (
    ("head_fixed", ""),
    ("pan_only", ""),
    ("straight", ""),
    ("spin", ""),
    ("base_fixed", ""),
    ("standard", "head_eye"),
)
_STATIONS = 12


def one_run(motion: str, fix: str, seed: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Error divided by the stated sigma, NaN for unobservable parameters, and their names."""
    robot, route = paper_robot(), route_of(_STATIONS, seed // RUNS_PER_ROUTE, motion)  # type: ignore[arg-type]
    extraction = ideal_extraction(robot, route, DISTURBED, seed)
    rig = replace(extraction.rig, noise=GIVEN)
    if fix:
        T_h_reference = robot.T_h_c @ rig.cameras.T_c_reference
        rig = replace(rig, nominal=replace(rig.nominal, T_h_reference=T_h_reference))
    try:
        solution = solve(
            replace(extraction, rig=rig), constraints=constraints_of([fix] if fix else [], [], [])
        )
    except SolveError:
        return np.full(9, np.nan), ("refused",)
    found = solution.uncertainty
    assert found is not None
    seen = found.observable
    ratio = np.where(seen, errors(solution.parameters, robot) / np.where(seen, found.std, 1.0), np.nan)
    return ratio, tuple(name for name, ok in zip(NINE, seen, strict=True) if not ok)


def main() -> None:
    """All cases; runs of each as an argument, 200 by default."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(conditions())
    print(
        f"\nN = {_STATIONS}, {runs} runs each, noise levels given: rms error divided by the stated sigma.\n"
    )
    header = (
        HEADER.replace(" (deg)", "")
        .replace(" (mm)", "")
        .replace("\n", " unobservable, number of runs |\n", 1)
    )
    print(header + " --- |")
    for motion, fix in _CASES:
        results = list(map_runs(one_run, [(motion, fix, seed) for seed in range(runs)]))
        marked = Counter(", ".join(r[1]) or "none" for r in results)
        values = np.array([r[0] for r in results])
        shown = np.isfinite(values).sum(axis=0)
        rms = np.sqrt(np.nansum(values**2, axis=0) / np.maximum(shown, 1))
        cells = " | ".join(f"{v:.2f}" if n > runs / 2 else "fixed" for v, n in zip(rms, shown, strict=True))
        says = "; ".join(f"{names}: {count}" for names, count in marked.most_common())
        print(f"| {motion}{f', {fix} fixed' if fix else ''} | {cells} | {says} |")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
