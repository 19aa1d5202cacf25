"""Covariance of wheel odometry for ROS 2: diff_drive_controller publishes it, robot_localization uses it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.text import rendered
from mobilecal_cli.kinematics import Increments, integrate
from mobilecal_cli.likelihood.dataset import Dataset, dataset_of
from mobilecal_cli.likelihood.legs import SLIP_M_PER_SQRT_M, leg_covariances
from mobilecal_cli.likelihood.processes import mean_variance, rolled_m
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.ranges import DISTANCE, ODOMETRY_RATE

#: Shorter legs are those between images in motion, or hardly a drive.
_LEAST_LEG_M = 0.25
#: Variance of a quantity that wheels do not measure: a filter gives it no weight.
UNKNOWN = 1e6
_LEVEL = 0.95  # of the intervals that are widened because the noise levels are estimates
_SAMPLE_S, _WINDOW = 0.1, 3  # a wheel turns if it does within this many samples
_STANDS_RAD = 2e-3
_STEPS = 100  # of a straight drive, and of a turn
_PLAIN_DRIVE_M = 1.0  # for wheels that the recording does not determine
_WHEEL_LEVELS = frozenset({"wheel_rad_per_sqrt_rad", "wheel_share"})


def export(of: Source, rate_hz: float | None = None, distance_m: float | None = None) -> Exported:
    """[covariance of wheel odometry](../how-to/apply-the-result.md#odometry-covariance) for `diff_drive_controller`
    and robot_localization; `--rate HZ` (default 50), `--distance METERS` (default: the legs of the recording)
    """
    rate_hz = ODOMETRY_RATE.check("--rate", 50.0 if rate_hz is None else rate_hz)
    if distance_m is not None:
        DISTANCE.check("--distance", distance_m)
    covariance = odometry_covariance(of.robot, of.measurements(), rate_hz, distance_m)
    short = distance_m is None and covariance.path_m < _LEAST_LEG_M
    note = (
        f"The legs of the recording are {covariance.path_m:.2f} m long on average, and the covariance applies to "
        "such drives. Give the length of your drives with --distance."
    )
    topic = "/diff_drive_controller/odom" if of.robot.odometry is None else of.robot.odometry.topic
    content = rendered("odometry_covariance.yaml", covariance=covariance, topic=topic)
    return Exported(content.encode(), (note,) if short else ())


@dataclass(frozen=True, slots=True, eq=False)
class OdometryCovariance:
    """Diagonals in the order of ROS: x, y, z, rotation about x, y, z. x is along a drive, y across it.

    Attributes:
        pose: (6,) variances of the pose after a drive, m^2 and rad^2; x along the line from its start to its end.
        correlation: (3, 3) of x, y and heading after a drive.
        twist: (6,) variances of the velocity in one message, (m/s)^2 and (rad/s)^2.
        rate_hz: odometry messages per second that `twist` applies to.
        motion: the drives that the variances apply to, in words.
        legs: number of legs of the recording, which the noise levels come from.
        path_m, moving_s: path and time in motion of these drives, mean.
        widening: factor on the variances, because the noise levels are estimated from few legs.
        systematic: (2,) share of the variances of length and heading from proportional noise and the covariance of the
            calibration. It grows with the square of the distance, the rest with the distance.
    """

    pose: FloatArray
    correlation: FloatArray
    twist: FloatArray
    rate_hz: float
    motion: str
    legs: int
    path_m: float
    moving_s: float
    widening: float
    systematic: FloatArray


def odometry_covariance(
    robot: CalibratedRobot, extraction: Extraction, rate_hz: float, distance_m: float | None = None
) -> OdometryCovariance:
    """Covariance of odometry with calibrated wheels, from the noise levels and the covariance of the calibration.

    A filter that adds up the velocities of n messages with independent errors of variance s^2, at intervals of dt,
    obtains a length with variance n s^2 dt^2. `twist` makes this equal to the variance over some drives, for the
    messages while the robot moves: s^2 = rate_hz * (sum of the variances) / (sum of the times in motion).

    A recording does not show the errors of the wheels that it does not determine. The drive is then straight (1 m by
    default) with a full turn in place at its end, so that the full width of their covariance counts.

    Args:
        robot: the calibration, with standard deviations.
        extraction: its measurements.
        rate_hz: odometry messages per second.
        distance_m: for straight drives of this length at the recording's speed; for the legs of the recording if None.

    Raises:
        ConfigError: the calibration states no noise of the wheels, or the robot does not drive in the recording.
    """
    known = robot.knowledge
    if known is None or not known.noise.keys() >= _WHEEL_LEVELS:
        raise ConfigError(
            "params.yaml does not state the noise of the wheels",
            "calibrate extraction.npz again with this version and --method ml",
        )
    data = dataset_of(extraction)
    exact = Noise.exact()
    noise = exact.with_levels({name: known.noise[name] for name in exact.levels.keys() & known.noise.keys()})
    wheels, C = robot.wheels, known.covariance[6:, 6:]
    moving_s, speed_mps = _motion(data, wheels)
    if moving_s <= 0 or speed_mps <= 0:
        raise ConfigError(
            "the robot does not drive in the recording, so the noise of the wheels is unknown",
            "calibrate from a recording with motion",
        )
    steps, motion = data.steps(), ""
    if distance_m is not None or robot.unobservable[6:].any():
        turn_rad = 2 * np.pi if robot.unobservable[6:].any() else 0.0
        distance_m = _PLAIN_DRIVE_M if distance_m is None else distance_m
        steps = _straight_and_turn(distance_m, turn_rad, wheels)
        moving_s = (distance_m + turn_rad * wheels.separation_m / 2) / speed_mps
        motion = f"{distance_m:g} m straight ahead" + (", then a full turn in place" if turn_rad else "")
    random, systematic = _of_length_and_heading(data, steps, wheels, noise, C)
    both, pose = random + systematic, _of_pose(data, steps, wheels, noise, C)
    std = np.sqrt(np.diag(pose))
    right, left = wheels.radius_right_m * steps.right_rad, wheels.radius_left_m * steps.left_rad
    path_m = float(np.abs(right + left).sum() / 2)
    if not motion:
        degrees = math.degrees(np.abs(right - left).sum() / wheels.separation_m / steps.legs)
        motion = f"the {steps.legs} legs of the recording, on average {path_m / steps.legs:.2f} m and {degrees:.0f} deg"
    # Each leg adds about one redundant number about the noise of the wheels. Where that is not given, the factor is the
    # squared ratio of the quantiles of Student's t and the normal distribution.
    legs, upper = len(data.legs), (1 + _LEVEL) / 2
    estimated = not extraction.rig.noise.keys() >= _WHEEL_LEVELS
    widening = float((stdtrit(legs, upper) / ndtri(upper)) ** 2) if estimated else 1.0
    rate = rate_hz / moving_s
    slip = SLIP_M_PER_SQRT_M**2 * path_m
    floor = np.array([noise.floor_m, noise.floor_rad, noise.floor_rad]) ** 2
    return OdometryCovariance(
        pose=np.concatenate([widening * np.diag(pose)[:2], floor, [widening * pose[2, 2]]]),
        correlation=pose / np.outer(std, std),
        twist=np.array(
            [widening * rate * both[0], rate * slip, UNKNOWN, UNKNOWN, UNKNOWN, widening * rate * both[1]]
        ),
        rate_hz=rate_hz,
        motion=motion,
        legs=legs,
        path_m=path_m / steps.legs,
        moving_s=moving_s / steps.legs,
        widening=widening,
        systematic=systematic / both,
    )


def _motion(data: Dataset, wheels: WheelGeometry) -> tuple[float, float]:
    """Time in which a wheel turns, over all legs, s, and the speed of driving, mean over the path, m/s."""
    moving, speeds = 0, [np.zeros(0)]
    stands = _STANDS_RAD + 1.5 * data.encoder_step_rad
    span_s = _SAMPLE_S * _WINDOW
    for number, track in enumerate(data.tracks):
        times = data.times_ns[data.log == number]
        if len(times) < 2:
            continue
        at = np.arange(times[0], times[-1], round(_SAMPLE_S * 1e9))
        rotation = np.stack([track.right.at(at), track.left.at(at)], axis=1)
        turned = rotation[_WINDOW:] - rotation[:-_WINDOW]
        moving += int(np.any(np.abs(turned) > stands, axis=1).sum())
        speeds.append(np.abs(turned @ wheels.vector[:2]) / 2 / span_s)
    speed = np.concatenate(speeds)
    return moving * _SAMPLE_S, float(np.sum(speed**2) / max(np.sum(speed), 1e-12))


def _straight_and_turn(distance_m: float, turn_rad: float, wheels: WheelGeometry) -> Increments:
    """One leg in steps: straight ahead, then a turn in place."""
    rim_m = turn_rad * wheels.separation_m / 2
    right, left = (
        np.repeat([distance_m, sign * rim_m], _STEPS) / _STEPS / radius
        for sign, radius in zip((1, -1), wheels.vector[:2], strict=True)
    )
    return Increments(right, left, np.zeros(2 * _STEPS, dtype=np.int64), 1)


def _of_pose(
    data: Dataset, steps: Increments, wheels: WheelGeometry, noise: Noise, C: FloatArray
) -> FloatArray:
    """(3, 3) covariance of a leg's end, mean over the legs.

    Order: along and across the line from its start to its end (m), heading (rad).
    """
    nothing = np.zeros((steps.legs, 2))
    whole = steps.with_ends(nothing, nothing)  # every leg has a step
    arcs = integrate(whole, wheels)
    by_wheels = arcs.by_wheels()
    covariance = sum(leg_covariances(whole, wheels, noise).values()) + by_wheels @ C @ by_wheels.mT
    variance = (noise.encoder_rad * data.encoder_shares) ** 2
    legs = np.arange(steps.legs)
    for at in (np.searchsorted(whole.leg, legs), np.searchsorted(whole.leg, legs, side="right") - 1):
        by_reading = arcs.sensitivity(at)
        covariance = covariance + (by_reading * variance) @ by_reading.mT
    x, y = arcs.t_m.T
    along = np.zeros((steps.legs, 3, 3))
    along[:, :2, :2] = se3.exp_so3(np.arctan2(y, x)[:, None] * [0.0, 0.0, 1.0])[:, :2, :2].mT
    along[:, 2, 2] = 1.0
    return np.asarray((along @ covariance @ along.mT).mean(axis=0))


def _of_length_and_heading(
    data: Dataset, steps: Increments, wheels: WheelGeometry, noise: Noise, C: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variances of the driven length (m^2) and of the heading (rad^2), sums over the legs.

    Returns:
        (2,) random: grows with the rotation of the wheels; (2,) systematic: with its square.
    """
    rR, rL, b = wheels.vector
    Phi = steps.totals_rad
    turned = (rR * Phi[:, 0] - rL * Phi[:, 1]) / b
    by_rotation = np.array([[rR / 2, rL / 2], [rR / b, -rL / b]])
    rolled = np.array([np.abs(steps.right_rad).sum(), np.abs(steps.left_rad).sum()])
    readings = (
        2 * (noise.encoder_rad * data.encoder_shares) ** 2 * steps.legs
    )  # at the start and the end of each leg
    random = by_rotation**2 @ (noise.wheel_rad_per_sqrt_rad**2 * rolled + readings)
    alike = mean_variance(rolled_m(steps, wheels) / noise.wheel_length_m)
    proportional = by_rotation**2 @ (noise.wheel_share**2 * (Phi**2 * alike).sum(axis=0))
    for_length = np.stack([Phi[:, 0] / 2, Phi[:, 1] / 2, np.zeros(len(Phi))], axis=1)
    for_heading = np.stack([Phi[:, 0], -Phi[:, 1], -turned], axis=1) / b
    calibration = np.array([np.sum((G @ C) * G) for G in (for_length, for_heading)])
    return random, proportional + calibration
