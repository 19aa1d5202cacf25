"""The jobs of a batch on a Dask cluster: the extra `cluster`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import FleetJob, FleetRow
from mobilecal_cli.pipeline.fleet import Run, run_job


def run_on(address: str, timeout_s: float = 30.0) -> Run:
    """Workers of a scheduler, which see the same files under the same paths.

    A worker that dies loses nothing: the scheduler gives its jobs to others, and what had been done is found done.

    Args:
        address: of the scheduler, `tcp://host:8786`.
        timeout_s: how long to wait for it.

    Raises:
        ConfigError: the extra is not installed, or no scheduler answers.
    """

    def run(jobs: Sequence[FleetJob], done: Callable[[FleetRow], None]) -> None:
        try:
            from distributed import Client, as_completed
        except ImportError as error:
            raise ConfigError(
                "a Dask cluster needs the extra `cluster`",
                "pip install 'mobilecal[cluster]', here and on the workers",
            ) from error
        try:
            client = Client(address, timeout=timeout_s)  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {address}: no scheduler answers: {error}",
                "start one: dask scheduler, dask worker",
            ) from error
        with client:
            futures = {
                client.submit(run_job, job, key=f"mobilecal-{job.name}", pure=False): job for job in jobs
            }
            for future in as_completed(list(futures)):  # type: ignore[no-untyped-call]
                failed = future.exception()
                done(future.result() if failed is None else _lost(futures[future], failed))

    return run


def _lost(job: FleetJob, error: BaseException) -> FleetRow:
    reason = f"the workers that calibrated it died or failed: {type(error).__name__}: {error}"
    return FleetRow(job.name, "ERROR", 1, reason)
