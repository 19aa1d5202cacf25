"""The maximum-likelihood fit of an extraction, without what the product makes of it."""

from __future__ import annotations

from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.maximum_likelihood import robust_fit


def maximum_likelihood(
    extraction: Extraction, constraints: Constraints | None = None, start: Parameters | None = None
) -> LikelihoodFit:
    """The fit under some constraints, from the linear solution or from given parameters."""
    return robust_fit(Inference.of(extraction, constraints or Constraints()), start)
