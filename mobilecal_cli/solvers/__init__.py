"""Solvers: the iterative linear method, its refinements, maximum likelihood, and the evaluation of a calibration."""

from mobilecal_cli.solvers.constraints import Constraints, checked_constraints, constraints_of
from mobilecal_cli.solvers.evaluate import clock_offsets, evaluate
from mobilecal_cli.solvers.solve import solve

__all__ = ["Constraints", "checked_constraints", "clock_offsets", "constraints_of", "evaluate", "solve"]
