"""One, two and three cameras on the base, on a head that pans and on one that pans and tilts: are the sigmas true?

Every constant is drawn from its prior; 20 stops. NEES / n is over the n parameters that the motion shows: all nine, or
all but the camera's height where no joint tilts the camera.
"""

from tests.bench.imperfect import AS_PRINTED, USUAL, VERDICTS, Case, configuration, print_cases, verdict_cells
from tests.bench.study import Study
from tests.robots import CONFIGURATIONS

RUNS = 100


def main(asked: Study) -> None:
    """All configurations, noise levels estimated."""
    cases = {
        (str(cameras), chain): Case(configuration(cameras, chain)).drawn(
            noise=USUAL, outside=AS_PRINTED, levels_drawn=True
        )
        for cameras, chain in CONFIGURATIONS
    }
    print_cases(asked, cases, ("cameras", "chain", *VERDICTS), lambda runs, _: verdict_cells(runs))
