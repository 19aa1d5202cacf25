"""The commands. Each is a few lines; `main` turns errors into messages and exit codes."""

from __future__ import annotations

import sys

from mobilecal_cli.cli import calibrating, fleet, looking, simulating, using
from mobilecal_cli.cli.app import app
from mobilecal_cli.errors import MobilecalError

__all__ = ["app", "calibrating", "fleet", "looking", "main", "simulating", "using"]


def main() -> None:
    """Run the command line and leave with the exit code that fits."""
    try:
        app()
    except MobilecalError as error:
        from mobilecal_cli.model.text import visible  # names out of a log must not steer the terminal

        print(f"error: {visible(error.message)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {visible(error.hint)}", file=sys.stderr)
        sys.exit(error.exit_code)
