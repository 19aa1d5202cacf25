"""The command, and python -m mobilecal_cli: Ctrl-C leaves alike at any moment, also while modules are loaded."""

import sys

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and leave with the exit code that fits."""
    try:
        from mobilecal_cli.cli import main as run

        run()
    except KeyboardInterrupt:
        leaving = _INTERRUPTED
    except SystemExit as error:  # typer has turned Ctrl-C into an exit by now
        if error.code != _INTERRUPTED:
            raise
        leaving = _INTERRUPTED
    else:
        return
    print("interrupted: nothing was written", file=sys.stderr)
    sys.exit(leaving)


if __name__ == "__main__":
    main()
