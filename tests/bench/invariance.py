"""What must not matter: threads of linear algebra, 1e-6 px, the order of recordings, one recording cut in two."""

import pickle
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.signals import Track
from mobilecal_cli.solvers import solve
from tests.bench.imperfect import CORRELATED, Case
from tests.bench.study import Study, head, line, measured
from tests.extractions import joined
from tests.judging import judge
from tests.pairs import with_views

#: Cases, times of the priors that constants are drawn from, and number of recordings.
RECORDINGS = (
    ("20 stations", Case(stations=20), 1.0, 5),
    ("40 stations", Case(stations=40), 1.0, 3),
    ("80 images in motion", Case(motion="moving", images=80), 1.0, 4),
    ("20 stations, 3 times the priors", Case(stations=20), 3.0, 4),
    ("40 images in motion, 3 times the priors", Case(motion="moving"), 3.0, 4),
)
RUNS = sum(count for *_, count in RECORDINGS)
_NOISE_PX, _LIMIT = 1e-6, 0.05


def recordings() -> list[tuple[str, Extraction]]:
    """All recordings, with a name."""
    made = []
    for name, case, times, count in RECORDINGS:
        drawn = case.drawn(times, noise=CORRELATED)
        made += [(f"{name}, seed {10 * seed}", drawn.extraction(10 * seed)) for seed in range(count)]
    return made


def shaken(extraction: Extraction) -> Extraction:
    """The same with 1e-6 px of noise on all corners."""
    random = np.random.default_rng(3)
    seen = []
    for o in extraction.observations:
        moved = (v.pixels + _NOISE_PX * random.normal(size=v.pixels.shape) for v in o.views)
        seen.append(with_views(o, *(replace(v, pixels=at) for v, at in zip(o.views, moved, strict=True))))
    return replace(extraction, observations=tuple(seen))


def cut(extraction: Extraction, exchanged: bool = False) -> Extraction:
    """One recording as two, cut between its middle stations; optionally the second one first."""
    seen, wheels, joints = extraction.observations, extraction.wheels[0], extraction.joint_tracks[0]
    middle = len(seen) // 2
    moment_ns = (seen[middle - 1].time_ns + seen[middle].time_ns) // 2

    def part(track: Track, late: bool) -> Track:
        mine = (track.time_ns > moment_ns) == late
        return Track(track.time_ns[mine], track.value[mine])

    halves = [
        replace(
            extraction,
            observations=tuple(
                replace(o, station=k) for k, o in enumerate(seen[middle:] if late else seen[:middle])
            ),
            wheels=(WheelTrack(part(wheels.right, late), part(wheels.left, late)),),
            joint_tracks=(tuple(part(track, late) for track in joints),),
        )
        for late in ((True, False) if exchanged else (False, True))
    ]
    return joined(*halves)


VARIANTS = {
    "as recorded": lambda extraction: extraction,
    "1e-6 px": shaken,
    "cut in two": cut,
    "cut in two, exchanged": lambda extraction: cut(extraction, exchanged=True),
}


def answer(extraction: Extraction) -> dict[str, Any]:
    """Verdict, the nine and their standard deviations."""
    try:
        solution = solve(extraction)
    except MobilecalError as error:
        return {"level": f"refused: {error.message[:60]}"}
    known = solution.uncertainty
    assert known is not None
    return {
        "level": judge(solution, extraction).level,
        "T": solution.parameters.T_h_c.tolist(),
        "wheels": solution.parameters.wheels.vector.tolist(),
        "std": known.std.tolist(),
    }


def work(path: str, *names: str) -> list[dict[str, Any]]:
    """The answers for some variants of all recordings of a file."""
    made = pickle.loads(Path(path).read_bytes())  # written by `main`
    return [{name: answer(VARIANTS[name](each)) for name in names} for _, each in made]


def answers(path: Path, threads: int, names: list[str]) -> list[dict[str, Any]]:
    """`work` in a process with a number of threads of linear algebra."""
    variables = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), str(threads))
    found: list[dict[str, Any]] = measured(work, path, *names, **variables)
    return found


def apart(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Largest difference of the nine in standard deviations of the first; NaN where one was refused."""
    if "T" not in one or "T" not in other:
        return float("nan")
    return float(np.max(np.abs(_nine(other).minus(_nine(one))) / one["std"]))


def lost(whole: dict[str, Any], parts: dict[str, Any]) -> float:
    """Standard deviation of the difference that the missing leg explains, in sigmas of the whole: the largest."""
    if "T" not in whole or "T" not in parts:
        return float("nan")
    more = (np.array(parts["std"]) / np.array(whole["std"])) ** 2 - 1
    return float(np.sqrt(max(more.max(), 0.0)))


def _nine(result: dict[str, Any]) -> Parameters:
    return Parameters(np.array(result["T"]), WheelGeometry.of(np.array(result["wheels"])))


def main(asked: Study) -> None:
    """Twenty recordings, or as many of them as there are runs."""
    made = recordings()[: asked.runs]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recordings.pickle"
        path.write_bytes(pickle.dumps(made))
        one = answers(path, 1, list(VARIANTS))
        two = answers(path, 2, ["as recorded"])
    rows = {
        "two threads": [(a["as recorded"], b["as recorded"]) for a, b in zip(one, two, strict=True)],
        "1e-6 px on the corners": [(a["as recorded"], a["1e-6 px"]) for a in one],
        "the two parts in the other order": [(a["cut in two"], a["cut in two, exchanged"]) for a in one],
        "cut in two and pooled": [(a["as recorded"], a["cut in two"]) for a in one],
    }
    title = f"{len(made)} recordings."
    head("", "other verdict", "largest difference (sigma)", f"beyond {_LIMIT:g} sigma", title=title)
    for label, pairs in rows.items():
        differences = np.array([apart(a, b) for a, b in pairs])
        others = sum(a["level"] != b["level"] for a, b in pairs)
        line(label, others, f"{np.nanmax(differences):.2g}", int(np.sum(differences > _LIMIT)))
        for (name, _), (a, b), difference in zip(made, pairs, differences, strict=True):
            if a["level"] != b["level"] or difference > _LIMIT:
                missing = f", the leg explains {lost(a, b):.2f} sigma" if label.startswith("cut") else ""
                print(f"  {name}: {a['level']}, then {b['level']}; {difference:.3f} sigma{missing}")
