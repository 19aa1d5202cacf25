"""Texts against their golden copies; `RENEW_GOLDEN=1 pytest tests/report tests/commands` writes these anew."""

import os
import re
from pathlib import Path

GOLDEN = Path(__file__).parent / "report" / "golden"


def masked(text):
    """A text without its digits, which differ between versions of the linear algebra, and without directories."""
    text = re.sub(r"(/[\w.-]+)+/(?=[\w-]+\.(mcap|yaml))", "", text)
    return re.sub(r" *[-+]?[0-9]+(\.[0-9]+)?(e-?[0-9]+)?", " #", text)


def assert_golden(text, name):
    path = GOLDEN / f"{name}.txt"
    if "RENEW_GOLDEN" in os.environ:
        path.write_text(masked(text), encoding="utf-8")
    assert masked(text) == path.read_text(encoding="utf-8"), path
