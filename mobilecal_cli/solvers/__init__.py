"""From observations to the nine numbers: the iterative linear method and its refinements."""

from mobilecal_cli.solvers.solve import solve

__all__ = ["solve"]
