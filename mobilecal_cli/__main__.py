"""The command, and python -m mobilecal_cli: Ctrl-C leaves alike at any moment, also while modules are loaded."""

import sys

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and leave with the exit code that fits."""
    try:
        from mobilecal_cli.cli import main as run

        run()
        return
    except KeyboardInterrupt:
        pass
    except SystemExit as leaving:  # typer has turned Ctrl-C into an exit by now
        if leaving.code != _INTERRUPTED:
            raise
    print("interrupted: what was not finished was not written", file=sys.stderr)
    sys.exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
