from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from mobilecal_cli.errors import SolveError
from mobilecal_cli.solvers import optimize as module
from mobilecal_cli.solvers.optimize import optimize


@dataclass
class Kinked:
    """A likelihood along whose kinks each step gains the same, half of what it promises."""

    gain: float
    cost: float = 9527.0

    priors = SimpleNamespace(step_to_mean=lambda state: np.zeros(1))
    state = SimpleNamespace(parameters=SimpleNamespace(wheels=SimpleNamespace(separation_m=0.3)))

    def after(self, step):
        return Kinked(self.gain, self.cost - self.gain)


@pytest.mark.parametrize(("gain", "ends"), [(0.015, True), (0.5, False)])
def test_steps_that_gain_little_for_long(monkeypatch, gain, ends):
    """Images, joints and wheels with stamps that are off by 10 ms: "did not converge" refused a right result."""
    monkeypatch.setattr(module, "proposed", lambda lin, damping=0.0: (None, 2 * lin.gain))
    if ends:
        lin, costs = optimize(Kinked(gain), most_steps=20)
        assert lin.cost == costs[-1] == pytest.approx(9527 - 20 * gain)
    else:
        with pytest.raises(SolveError, match="did not converge in 20 steps"):
            optimize(Kinked(gain), most_steps=20)
