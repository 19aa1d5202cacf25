"""Formats of `export` by what they are: tests that go over them have a new one at once."""

from importlib import import_module
from pathlib import Path

from mobilecal_cli.export.formats import Source, format_of
from mobilecal_cli.targets import Target

HEAD_EYE = tuple(
    str(name)
    for name in Target
    if name == "json" or hasattr(import_module(f"mobilecal_cli.export.formats.{name}"), "of_head_eye")
)


def text_of(name, robot):
    """A calibration in a format that needs nothing else."""
    return format_of(name)(Source(robot, Path("params.yaml"), None, None)).content.decode()
