"""python -m mobilecal_cli."""

from mobilecal_cli.cli import main

main()
