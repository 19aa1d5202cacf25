"""Estimate the nine parameters: the iterative linear method, its refinements, and maximum likelihood."""

from mobilecal_cli.solvers.asked import Asked, asked_of
from mobilecal_cli.solvers.evaluate import clock_offsets, evaluate
from mobilecal_cli.solvers.solve import solve

__all__ = ["Asked", "asked_of", "clock_offsets", "evaluate", "solve"]
