"""The hunt: mutated inputs by the thousand, in processes that may hang or die without ending it.

`python -m tests.fuzz.hunt COUNT [FIRST]` prints a table and every finding; case N is the same in every run.
"""

import faulthandler
import multiprocessing as mp
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.queues import SimpleQueue
from pathlib import Path

from mobilecal_cli.errors import MobilecalError
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import Target, place, targets

#: Processor time of an input that hangs, and time on the clock, which a busy machine stretches.
HANG_S, BLOCKED_S = 10.0, 120.0
#: Address space that an input may make the process ask for beyond what it has when the hunt begins.
MEMORY_BYTES = 3 * 2**29


@dataclass
class Haul:
    """What a hunt found.

    Attributes:
        outcomes: target and outcome → count; "read", or the class of the documented error.
        findings: case and what went wrong, one line and more.
        peak_mb: the largest resident memory of a process.
        slowest: seconds of processor time, case.
    """

    outcomes: Counter[tuple[str, str]] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)
    peak_mb: float = 0.0
    slowest: tuple[float, int] = (0.0, -1)


def attempt(name: str, target: Target, case: int, folder: Path) -> str:
    """Use one mutated input: "read" or the class of the documented error.

    Raises:
        Exception: anything else that the product raised: a finding.
    """
    dice = random.Random(f"{name} {case}")
    contents = dict(target.files)
    victim = dice.choice(sorted(contents))
    contents[victim] = mutated(contents[victim], dice)
    path = place(target, contents, folder / "input")
    try:
        target.use(path)
    except MobilecalError as error:
        if "MemoryError" in error.message:
            raise MemoryError(error.message) from error
        return type(error).__name__
    return "read"


def _peak_mb() -> float:
    """Peak resident memory of this process by its own page tables: getrusage's counts what its parent had, too."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def _work(
    every: dict[str, Target], first: int, last: int, step: int, case: mp.Value, reports: SimpleQueue
) -> None:
    """Cases first, first + step, ... below last."""
    warnings.simplefilter("ignore")  # numpy's on absurd numbers
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary, Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)  # image libraries complain there
        folder = Path(temporary)
        names = sorted(every)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        for number in range(first, last, step):
            case.value = number
            name = names[number % len(names)]
            faulthandler.dump_traceback_later(BLOCKED_S, exit=True)
            signal.setitimer(signal.ITIMER_PROF, HANG_S)  # ends the process
            start = time.process_time()
            try:
                outcome, wrong = attempt(name, every[name], number, folder), ""
            except BaseException as error:
                outcome = f"FOUND {type(error).__name__}"
                wrong = f"case {number} ({name}): {''.join(traceback.format_exception(error)[-6:])}"
            signal.setitimer(signal.ITIMER_PROF, 0)
            faulthandler.cancel_dump_traceback_later()
            reports.put((number, name, outcome, wrong, time.process_time() - start))
        reports.put((last, "", "peak", "", _peak_mb()))
    case.value = -1


def hunt(every: dict[str, Target], count: int, first: int = 0) -> Haul:
    """Try so many cases of some targets."""
    workers = os.cpu_count() or 1
    # A process that dies is replaced by a fork of one that has all modules.
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(["tests.fuzz.hunt"])
    reports = context.SimpleQueue()  # what a process put is there, even if it dies next
    haul, last = Haul(), first + count

    def start(at: int) -> tuple[mp.Process, mp.Value]:
        case = context.Value("q", at)
        process = context.Process(target=_work, args=(every, at, last, workers, case, reports))
        process.start()
        return process, case

    running = [start(first + k) for k in range(min(workers, count))]
    while running or not reports.empty():
        while not reports.empty():
            number, name, outcome, wrong, seconds = reports.get()
            if outcome == "peak":
                haul.peak_mb = max(haul.peak_mb, seconds)
                continue
            haul.outcomes[name, outcome] += 1
            haul.slowest = max(haul.slowest, (seconds, number))
            if wrong:
                haul.findings.append(wrong)
        for process, case in list(running):
            if process.is_alive():
                continue
            running.remove((process, case))
            if process.exitcode != 0 or case.value >= 0:
                ended = f"the process ended with {process.exitcode}: hang or crash"
                haul.findings.append(f"case {case.value}: {ended}")
                haul.outcomes["", "FOUND hang or crash"] += 1
                if case.value + workers < last:
                    running.append(start(case.value + workers))
        time.sleep(0.05)
    return haul


def main() -> None:
    """Print what a hunt of COUNT cases found."""
    count, first = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        every = targets(Path(temporary))
    haul = hunt(every, count, first)
    names = sorted({name for name, _ in haul.outcomes})
    kinds = sorted({outcome for _, outcome in haul.outcomes})
    print(f"| input | {' | '.join(kinds)} |\n|{' --- |' * (len(kinds) + 1)}")
    for name in names:
        print(f"| {name} | " + " | ".join(str(haul.outcomes[name, kind]) for kind in kinds) + " |")
    print(f"\n{sum(haul.outcomes.values())} inputs, {len(haul.findings)} findings; "
          f"peak {haul.peak_mb:.0f} MB a process; slowest {haul.slowest[0]:.1f} s (case {haul.slowest[1]})")  # fmt: skip
    for finding in haul.findings:
        print(f"\n{finding}")


if __name__ == "__main__":
    main()
