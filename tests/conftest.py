"""Fixtures that every room shares."""

import gc
import hashlib
import os
import pickle
from functools import wraps
from pathlib import Path

# Two test processes on two cores: threads of the linear algebra would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The commands that tests start keep their byte code, as on a user's machine: compiling takes a quarter of their start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from hypothesis import settings

# The same examples in every run: a failure in CI is a failure here.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

REPOSITORY = Path(__file__).resolve().parent.parent


def pytest_collection_finish() -> None:
    """Modules and collected tests stay to the end: the garbage collector need not look at them again and again."""
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The read-only data that others made; it lies beside the repository, not in it."""
    path = REPOSITORY.parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip("the test data that others made (../shared/data) is not on this machine")
    return path


@pytest.fixture(scope="session", autouse=True)
def every_report_fits_its_schema():
    """Each report.json that a test writes in its own process is validated."""
    from mobilecal_cli.calibrate.steps import Report
    from tests.report.schema import validated

    with pytest.MonkeyPatch.context() as patched:
        save = Report.save

        def checked(self, *given, **named):
            validated(self.json)
            save(self, *given, **named)

        patched.setattr(Report, "save", checked)
        yield


@pytest.fixture(scope="session", autouse=True)
def each_image_is_searched_once():
    """Many tests read the sample recordings: where find_board and identify_size have searched, they know the result.

    `fresh_search` searches anew; so do tests that call `vision.detect`.
    """
    from mobilecal_cli.vision import detection

    known = {}

    def remembered(search):
        @wraps(search)
        def found(image, *given):
            key = search.__name__, hashlib.sha256(image.tobytes()).digest(), image.shape, given
            if key not in known:
                known[key] = search(image, *given)
            return known[key]

        return found

    with pytest.MonkeyPatch.context() as patched:
        for name in ("detect", "_sizes_in"):
            patched.setattr(detection, name, remembered(getattr(detection, name)))
        yield


#: Where the commands call the solver.
SOLVED = ("mobilecal_cli.calibrate.steps.solve_extraction", "mobilecal_cli.calibrate.evaluate.solve")


@pytest.fixture(scope="session", autouse=True)
def each_extraction_is_solved_once():
    """Many commands run on the same measurements: then the solution is known.

    `fresh_search` solves anew; so do tests that call `solvers.solve`.
    """
    from mobilecal_cli.solvers import Constraints, solve

    known = {}

    def remembered(extraction, method="ml", constraints=None, **more):
        try:
            key = hashlib.sha256(pickle.dumps((extraction, method, constraints or Constraints()))).digest()
        except (pickle.PicklingError, AttributeError, TypeError):  # a robot made of a test's own functions
            return solve(extraction, method, constraints=constraints, **more)
        if key not in known:
            known[key] = solve(extraction, method, constraints=constraints, **more)
        return known[key]

    with pytest.MonkeyPatch.context() as patched:
        for name in SOLVED:
            patched.setattr(name, remembered)
        yield


@pytest.fixture
def fresh_search(monkeypatch):
    """Search images and solve anew what other tests or earlier lines have searched and solved."""
    from mobilecal_cli.solvers import solve
    from mobilecal_cli.vision import detection

    for name in ("detect", "_sizes_in"):
        monkeypatch.setattr(detection, name, getattr(detection, name).__wrapped__)
    for name in SOLVED:
        monkeypatch.setattr(name, solve)


@pytest.fixture
def few(monkeypatch):
    """Few images are looked at: enough where the board does not matter."""
    monkeypatch.setattr("mobilecal_cli.calibrate.inspect.PICTURE_MOMENTS", 2)


@pytest.fixture(scope="session")
def sample_logs() -> Path:
    """The recordings that the repository ships."""
    return REPOSITORY / "sample_logs"
