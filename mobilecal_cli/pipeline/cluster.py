"""Runs the jobs of a batch on a Dask cluster; needs the extra `cluster`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import FleetJob, FleetRow
from mobilecal_cli.pipeline.fleet import AGAIN, Run, run_job


def run_on(address: str, timeout_s: float = 30.0) -> Run:
    """Run jobs on the workers of a Dask scheduler, which must see the same files under the same paths.

    If a worker dies, the scheduler gives its jobs to other workers, which skip finished jobs.

    Args:
        address: of the scheduler, `tcp://host:8786`.
        timeout_s: longest time to wait for an answer of the scheduler, and for a worker, s.

    Raises:
        ConfigError: the extra is not installed, no scheduler answers, or it has no workers.
    """

    def run(jobs: Sequence[FleetJob], done: Callable[[FleetRow], None]) -> None:
        try:
            from distributed import Client, as_completed, rpc
        except ImportError as error:
            raise ConfigError(
                "the Dask package `distributed` is not installed",
                "run pip install '.[cluster]' in mobilecal's source directory, here and on the workers",
            ) from error

        async def identity() -> None:
            async with rpc(address) as scheduler:  # type: ignore[no-untyped-call]
                await scheduler.identity()

        try:
            # The client would wait without end for a program that accepts the connection and does not answer.
            asyncio.run(asyncio.wait_for(identity(), timeout_s))
            client = Client(address, timeout=timeout_s)  # type: ignore[no-untyped-call]
        except (OSError, ValueError, TimeoutError) as error:
            why = str(error) or f"no answer within {timeout_s:g} s"
            raise ConfigError(
                f"--scheduler {address}: cannot connect to the scheduler: {why}",
                "start a scheduler and workers with dask scheduler and dask worker, and check the address",
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=timeout_s)
            except TimeoutError as error:
                raise ConfigError(
                    f"--scheduler {address}: the scheduler has no workers after {timeout_s:g} s",
                    f"start workers: dask worker {address}",
                ) from error
            futures = {
                client.submit(run_job, job, key=f"mobilecal-{job.name}", pure=False): job for job in jobs
            }
            for future in as_completed(list(futures)):  # type: ignore[no-untyped-call]
                failed = future.exception()
                done(future.result() if failed is None else _lost(futures[future], failed))

    return run


def _lost(job: FleetJob, error: BaseException) -> FleetRow:
    reason = f"the worker process died or failed: {type(error).__name__}: {error}"
    return FleetRow(job.name, "ERROR", 1, reason, hint=AGAIN)
