"""From observations to the nine numbers: the iterative linear method, its refinements, maximum likelihood."""

from mobilecal_cli.solvers.asked import Asked, asked_of
from mobilecal_cli.solvers.evaluate import evaluate
from mobilecal_cli.solvers.solve import solve

__all__ = ["Asked", "asked_of", "evaluate", "solve"]
