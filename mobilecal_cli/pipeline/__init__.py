"""Joins the stages; what a notebook would call."""

from mobilecal_cli.pipeline.calibrate import Calibration, calibrate, default_output, suggest
from mobilecal_cli.pipeline.comparing import Comparison, Limits, compare
from mobilecal_cli.pipeline.draft import draft, write_draft
from mobilecal_cli.pipeline.evaluating import Evaluated, evaluate
from mobilecal_cli.pipeline.extract import extract
from mobilecal_cli.pipeline.inspecting import inspect
from mobilecal_cli.pipeline.junit import check_junit, write_junit, write_junit_error
from mobilecal_cli.pipeline.progress import Progress, silent

__all__ = [
    "Calibration",
    "Comparison",
    "Evaluated",
    "Limits",
    "Progress",
    "calibrate",
    "check_junit",
    "compare",
    "default_output",
    "draft",
    "evaluate",
    "extract",
    "inspect",
    "silent",
    "suggest",
    "write_draft",
    "write_junit",
    "write_junit_error",
]
