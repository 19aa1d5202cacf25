"""Errors against the known truth of a simulated robot."""

from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from mobilecal_cli import se3
from mobilecal_cli.likelihood.constants import Layout
from mobilecal_cli.likelihood.predict import expected, weights_of
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import SimulatedRobot


def parameters_of(robot: SimulatedRobot) -> Parameters:
    """The true parameters of a robot."""
    return Parameters(robot.T_h_c, robot.wheels)


def errors(found: Parameters, robot: SimulatedRobot) -> FloatArray:
    """(9,) found minus true: small rotation vector in the head's frame (rad), translation and wheels (m)."""
    return found.minus(parameters_of(robot))


def truth_of(path: Path) -> Parameters:
    """The true parameters that `simulate` writes beside a recording, as .truth.yaml."""
    data = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    rotation = se3.from_quaternion_xyzw(np.array(data["head_eye"]["quaternion_xyzw"]))
    translation = np.array(data["head_eye"]["translation_m"])
    return Parameters(se3.transform(rotation, translation), WheelGeometry(**data["wheels"]))


def nees(
    found: Parameters, covariance: FloatArray, robot: SimulatedRobot, kept: object = slice(None)
) -> float:
    """Squared error in standard deviations, over the number of parameters that are kept: 1 on average.

    The nine come first in the covariance.
    """
    index = np.arange(9)[kept]
    error = errors(found, robot)[index]
    return float(error @ np.linalg.solve(covariance[np.ix_(index, index)], error)) / len(index)


def no_priors(layout: Layout, anchor: Parameters) -> Priors:
    """No prior: every parameter is free, from the measurements alone."""
    zero = np.zeros(layout.size)
    return Priors(layout, anchor, zero, zero, zero > 0, np.zeros((0, len(NINE))), zero > 0, {})


def predicted(parameters, covariance):
    """Expected errors from the covariance of the nine parameters, (9, 9); the camera's are those of its pose on the head."""
    camera = np.zeros((1, 6, 9))
    camera[0, :3, :3] = camera[0, 3:, 3:6] = parameters.T_h_c[:3, :3].T
    return expected(weights_of(parameters, camera), covariance)
