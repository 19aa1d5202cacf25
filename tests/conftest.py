"""Fixtures that every room shares."""

from __future__ import annotations

import os
from pathlib import Path

# Two test processes on two cores: threads of the linear algebra would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

# The same examples in every run: a failure in CI is a failure here.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

REPOSITORY = Path(__file__).resolve().parent.parent


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


@pytest.fixture(scope="session")
def sample_logs() -> Path:
    """The recordings that the repository ships."""
    return REPOSITORY / "sample_logs"
