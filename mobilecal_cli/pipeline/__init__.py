"""Joins the stages; what a notebook would call."""

from mobilecal_cli.export import check_file, write_file
from mobilecal_cli.pipeline.calibrate import Calibration, calibrate, default_output, suggest
from mobilecal_cli.pipeline.cluster import run_on
from mobilecal_cli.pipeline.comparing import Comparison, Limits, compare
from mobilecal_cli.pipeline.draft import draft, write_draft
from mobilecal_cli.pipeline.evaluating import Evaluated, evaluate
from mobilecal_cli.pipeline.exporting import Exported, export
from mobilecal_cli.pipeline.extract import extract
from mobilecal_cli.pipeline.fleet import batch, run_locally
from mobilecal_cli.pipeline.inspecting import inspect
from mobilecal_cli.pipeline.junit import write_junit, write_junit_error
from mobilecal_cli.pipeline.progress import Progress, silent

__all__ = [
    "Calibration",
    "Comparison",
    "Evaluated",
    "Exported",
    "Limits",
    "Progress",
    "batch",
    "calibrate",
    "check_file",
    "compare",
    "default_output",
    "draft",
    "evaluate",
    "export",
    "extract",
    "inspect",
    "run_locally",
    "run_on",
    "silent",
    "suggest",
    "write_draft",
    "write_file",
    "write_junit",
    "write_junit_error",
]
