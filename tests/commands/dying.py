"""A job that kills its process; apart from the tests, so that a worker process imports little."""

import os
import signal

from mobilecal_cli.report.fleet import FleetRow


def die_or_answer(job):
    if job.name == "r1":
        os.kill(os.getpid(), signal.SIGKILL)
    return FleetRow(job.name, "PASS", 0, "")
