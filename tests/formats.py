"""Formats of `export` by what they are: tests that go over them have a new one at once."""

from importlib import import_module
from pathlib import Path

import numpy as np

from mobilecal_cli.export.formats import Source, format_of
from mobilecal_cli.model.findings import AtWork, Budget
from mobilecal_cli.model.solution import Noise, NoiseLevels, Uncertainty
from mobilecal_cli.targets import Target

HEAD_EYE = tuple(
    str(name)
    for name in Target
    if name == "json" or hasattr(import_module(f"mobilecal_cli.export.formats.{name}"), "of_head_eye")
)


def text_of(name, robot, **options):
    """A calibration in a format that needs no measurements."""
    return format_of(name)(Source(robot, Path("params.yaml"), None, None), **options).content.decode()


def small_uncertainty() -> Uncertainty:
    """An uncertainty of 1e-3 of each parameter, all observable."""
    noise = NoiseLevels(**Noise.limits("guess"), wider={}, estimated=(), redundancy={})
    return Uncertainty(
        np.eye(9) * 1e-6, np.eye(9) * 1e-6, np.ones(9, bool), np.zeros((0, 9)), np.ones(9), np.ones(9), noise, np.zeros(9, bool),
        np.ones(9), np.zeros(9, bool), np.ones(9), AtWork(*[1e-3] * 7), np.eye(6), (),
        Budget((), np.zeros((0, 9)), {}),
    )  # fmt: skip
