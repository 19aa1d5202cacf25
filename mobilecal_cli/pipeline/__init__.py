"""Joins the stages; what a notebook would call."""

from mobilecal_cli.pipeline.calibrate import Calibration, calibrate, default_output, suggest
from mobilecal_cli.pipeline.draft import draft, write_draft
from mobilecal_cli.pipeline.extract import extract
from mobilecal_cli.pipeline.inspecting import inspect
from mobilecal_cli.pipeline.progress import Progress, silent

__all__ = [
    "Calibration",
    "Progress",
    "calibrate",
    "default_output",
    "draft",
    "extract",
    "inspect",
    "silent",
    "suggest",
    "write_draft",
]
