"""Entry point of the command; Ctrl-C exits in the same way at any time, also during imports."""

import sys

_INTERRUPTED = 130


def main() -> None:
    """Run the command line; exit with code 130 on Ctrl-C."""
    try:
        from mobilecal_cli.cli import main as run

        run()
        return
    except KeyboardInterrupt:
        pass
    except SystemExit as leaving:  # typer turns Ctrl-C into an exit
        if leaving.code != _INTERRUPTED:
            raise
    print("interrupted: unfinished output was not written", file=sys.stderr)
    sys.exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
