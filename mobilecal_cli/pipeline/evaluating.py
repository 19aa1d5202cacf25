"""`mobilecal evaluate`: a calibration evaluated on a recording; and the split that `--hold-out` makes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mobilecal_cli import se3
from mobilecal_cli.config import load_rig
from mobilecal_cli.errors import ConfigError, MobilecalError, ObservationError, SolveError
from mobilecal_cli.export import parameters_from_yaml
from mobilecal_cli.likelihood.nuisance import camera_change, table
from mobilecal_cli.model import (
    SIDES,
    CalibratedRobot,
    Evaluation,
    Extraction,
    Knowledge,
    Nominal,
    Parameters,
    Solution,
    WheelGeometry,
)
from mobilecal_cli.pipeline.arguments import AnyPath, path_of
from mobilecal_cli.pipeline.loading import load
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.report.criteria import Check
from mobilecal_cli.report.evaluation import OwnEstimate, dependence, judge_evaluation
from mobilecal_cli.report.numbers import reference_frame, reference_pose
from mobilecal_cli.report.verdict import Verdict, evaluated_figures, gate_checks, gates_of
from mobilecal_cli.solvers import clock_offsets, solve
from mobilecal_cli.solvers import evaluate as evaluate_parameters
from mobilecal_cli.uncertainty import motion_gaps, require_stations
from mobilecal_cli.yaml_input import LARGEST_BYTES, read_text, reason_of

#: Two legs between held-out stations are the least that gives an error.
_LEAST_HELD_OUT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """Result of an evaluation.

    Attributes:
        evaluation: the figures.
        extraction: the recording's measurements.
        verdict: PASS, FAIL or NOT ENOUGH, with every check.
        checks: the user's gates.
        used: names of the recordings that the calibration was made from.
        notes: what to know about the figures, whole sentences.
    """

    evaluation: Evaluation
    extraction: Extraction
    verdict: Verdict
    checks: tuple[Check, ...]
    used: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_params(params: AnyPath) -> CalibratedRobot:
    """The calibration in a params.yaml.

    Raises:
        ConfigError: the file cannot be read, or is not a params.yaml.
        TypeError: not a path.
    """
    path = path_of("params", params)
    try:
        text = read_text(path, LARGEST_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{path}: cannot be read: {reason_of(error)}", "give a params.yaml that mobilecal wrote"
        ) from error
    return parameters_from_yaml(text, str(path))


def evaluate(
    logs: Sequence[Path],
    params: Path,
    *,
    before: Path | None = None,
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    gates: Sequence[str] = (),
    progress: Progress = silent,
) -> Evaluated:
    """Evaluate a calibration on recordings.

    Args:
        logs: recordings of the calibrated robot, or one extraction.npz.
        params: the calibration.
        before: another params.yaml, whose wheels dead reckoning is compared with; by default the nominal wheels.
        config_path: rig.yaml.
        flags: dotted key → value, over the file.
        gates: `NAME=LIMIT`, over those of the file.
        progress: receives the progress.

    Raises:
        MobilecalError: see `errors`.
    """
    robot = read_params(params)
    config = load_rig(config_path, flags)
    limits = gates_of(gates, config.gates, evaluating=True)
    wheels = read_params(before).wheels if before is not None else None
    extraction, _ = load(logs, config, config_path, flags or {}, progress)
    if len(extraction.wheels) == len(extraction.observations) or len(extraction.observations) < 2:
        raise ObservationError(
            f"the board was found at {len(extraction.observations)} stations: an evaluation needs two per recording",
            "give a recording with more stops in front of the board",
        )
    parameters = parameters_of(robot, extraction, params)
    progress("solving", 0, None)
    solution = _solved(extraction, robot)
    progress("evaluating", 0, None)
    nominal = extraction.rig.nominal.wheels
    own = _own_estimate(solution, extraction, robot) if isinstance(solution, Solution) else solution
    found = evaluate_parameters(
        extraction,
        parameters,
        wheels or nominal,
        offsets_s=clock_offsets(solution) if isinstance(solution, Solution) else {},
        reference=_reference(own, nominal),
    )
    used = used_for(robot, extraction)
    checks = tuple(gate_checks(limits, evaluated_figures(found)))
    verdict = judge_evaluation(found, extraction.rig.cameras, robot, own, used, checks)
    return Evaluated(found, extraction, verdict, checks, used, dependence(used, len(extraction.logs)))


def _solved(extraction: Extraction, robot: CalibratedRobot) -> Solution | MobilecalError:
    """The recording solved by itself as `calibrate` does, or the error that prevents it.

    Missing nominal values come from the calibration: parameters fixed there are not compared with it.
    """
    try:
        require_stations(extraction)
        try:
            return solve(extraction)
        except SolveError:
            rig = extraction.rig
            nominal = Nominal(
                robot.T_parent_child if rig.nominal.T_h_reference is None else rig.nominal.T_h_reference,
                rig.nominal.wheels or robot.wheels,
            )
            return solve(replace(extraction, rig=replace(rig, nominal=nominal)))
    except MobilecalError as error:
        return error


def _own_estimate(solution: Solution, extraction: Extraction, robot: CalibratedRobot) -> OwnEstimate:
    cameras, found = solution.cameras, solution.uncertainty
    assert found is not None  # the default method always has one
    knowledge = Knowledge(found.reference_covariance, found.observable)
    own = CalibratedRobot(
        robot.parent_frame,
        robot.child_frame,
        reference_pose(solution.parameters, cameras),
        solution.parameters.wheels,
        knowledge,
    )
    cure = "; ".join(gap.cure for gap in motion_gaps(extraction))
    return OwnEstimate(own, solution.residuals.leg_reprojection_px, cure)


def _reference(own: OwnEstimate | MobilecalError, nominal: WheelGeometry | None) -> WheelGeometry | None:
    """Wheels for path length and rotation that do not come from the calibration under test, if there are any."""
    if (
        isinstance(own, OwnEstimate)
        and own.robot.knowledge is not None
        and own.robot.knowledge.observable[6:].all()
    ):
        return own.robot.wheels
    return nominal


def used_for(robot: CalibratedRobot, extraction: Extraction) -> tuple[str, ...]:
    """Names of the recordings that a calibration was made from, found by their content."""
    made_from = {log.sha256 for log in robot.logs}
    return tuple(log.path for log in extraction.logs if log.sha256 in made_from)


def differences(robot: CalibratedRobot, extraction: Extraction) -> tuple[str, ...]:
    """What shows that a calibration was not made from these measurements: recordings, names and nominal sizes."""
    rig, nominal = extraction.rig, extraction.rig.nominal.wheels
    wheel_joints = {side: rig.sources.wheels[side].joint for side in SIDES if rig.sources.wheels[side].joint}
    logs, other_logs = (", ".join(sorted({log.sha256[:8] for log in of.logs})) for of in (robot, extraction))
    pairs: list[tuple[str, object, object]] = [
        ("recordings (SHA-256)", logs, other_logs),
        ("head frame", robot.parent_frame, rig.chain.head_frame),
        ("camera frame", robot.child_frame, reference_frame(rig.cameras)),
        ("wheel joints", dict(robot.wheel_joints), wheel_joints),
    ]
    if robot.nominal_wheels is not None and nominal is not None:
        mm, other_mm = (
            " ".join(f"{1e3 * m:.6g}" for m in of.vector) for of in (robot.nominal_wheels, nominal)
        )
        pairs.append(("nominal wheels in mm", mm, other_mm))
    return tuple(
        f"{what}: {own} in the calibration, {other} in the measurements"
        for what, own, other in pairs
        if own and other and own != other
    )


def parameters_of(robot: CalibratedRobot, extraction: Extraction, path: Path) -> Parameters:
    """The nine parameters of a calibration for the left camera of a recording's robot.

    Raises:
        ConfigError: the calibration is for other frames.
    """
    cameras = extraction.rig.cameras
    here = (extraction.rig.chain.head_frame, reference_frame(cameras))
    if (robot.parent_frame, robot.child_frame) != here:
        raise ConfigError(
            f"{path} gives the pose of {robot.child_frame!r} on {robot.parent_frame!r}; in the recording the camera "
            f"frame is {here[1]!r} and the head frame is {here[0]!r}",
            "set head.head_frame and cameras.reference as for the calibration",
        )
    rows = table(cameras, extraction.rig.chain)
    estimated = camera_change(rows, robot.constants or {}).apply(cameras)
    return Parameters(robot.T_parent_child @ se3.inverse(estimated.T_c_reference), robot.wheels)


def held_out(extraction: Extraction, share: float) -> tuple[Extraction, Extraction]:
    """A recording without the last share of each log's stations, and these held-out stations.

    Raises:
        ObservationError: too few stations would be held out.
    """
    last: set[int] = set()
    for log in range(len(extraction.wheels)):
        members = [n for n, o in enumerate(extraction.observations) if o.log == log]
        last |= set(members[len(members) - math.ceil(share * len(members)) :])
    if len(last) < _LEAST_HELD_OUT:
        raise ObservationError(
            f"--hold-out {share:g} holds out {len(last)} of {len(extraction.observations)} stations; at least "
            f"{_LEAST_HELD_OUT} are needed",
            "hold out a larger share, or record more stops",
        )
    searched = extraction.counts.get("stations", 0)
    kept = tuple(o for n, o in enumerate(extraction.observations) if n not in last)
    tried = tuple(o for n, o in enumerate(extraction.observations) if n in last)
    counts = {**extraction.counts, "stations": searched - len(tried)} if searched else extraction.counts
    return replace(extraction, observations=kept, counts=counts), replace(extraction, observations=tried)
