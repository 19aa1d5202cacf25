"""Formats of `export` by what they are: tests that go over them have a new one at once."""

from mobilecal_cli.export.formats import HeadEyeFormat, format_of
from mobilecal_cli.targets import Target

HEAD_EYE = tuple(made for made in map(format_of, Target) if isinstance(made, HeadEyeFormat))
