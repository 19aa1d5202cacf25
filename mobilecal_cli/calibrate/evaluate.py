"""`mobilecal evaluate`: a calibration evaluated on a recording; and the split that `--hold-out` makes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.gaps import motion_gaps, require_stations
from mobilecal_cli.calibrate.load import load, parameters_of, read_params, used_for
from mobilecal_cli.errors import ConfigError, MobilecalError, ObservationError, SolveError
from mobilecal_cli.model import (
    CalibratedRobot,
    Evaluation,
    Extraction,
    Knowledge,
    Nominal,
    Solution,
    WheelGeometry,
)
from mobilecal_cli.report.criteria import Check
from mobilecal_cli.report.evaluation import OwnEstimate, dependence, judge_evaluation
from mobilecal_cli.report.numbers import reference_pose
from mobilecal_cli.report.use import small_extents
from mobilecal_cli.report.verdict import Verdict, evaluated_figures, gate_checks, gates_of
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import clock_offsets, solve
from mobilecal_cli.solvers import evaluate as evaluate_parameters


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
    wheels: WheelGeometry | None = None
    extraction, _ = load(logs, config, progress)
    if len(extraction.wheels) == len(extraction.observations) or len(extraction.observations) < 2:
        raise ObservationError(
            f"the board was found at {len(extraction.observations)} stations: an evaluation needs two per recording",
            "give a recording with more stops in front of the board",
        )
    robot = _for_recording(robot, extraction, params)
    if before is not None:
        wheels = _for_recording(read_params(before), extraction, before).wheels
    parameters = parameters_of(robot, extraction, params)
    progress("solving", 0, None)
    solution = _solved(extraction, robot)
    progress("evaluating", 0, None)
    nominal = extraction.rig.nominal.wheels
    own = _own_estimate(solution, extraction, robot) if isinstance(solution, Solution) else solution
    # Path length and rotation by wheels that do not come from the calibration under test, if there are any.
    wheels_of_its_own = None
    if isinstance(own, OwnEstimate) and own.robot.knowledge and own.robot.knowledge.observable[6:].all():
        wheels_of_its_own = own.robot.wheels
    evaluation = evaluate_parameters(
        extraction,
        parameters,
        wheels or nominal,
        offsets_s=clock_offsets(solution) if isinstance(solution, Solution) else {},
        reference=wheels_of_its_own or nominal,
    )
    used = used_for(robot, extraction)
    checks = tuple(gate_checks(limits, evaluated_figures(evaluation)))
    verdict = judge_evaluation(evaluation, extraction.rig.cameras, robot, own, used, checks)
    return Evaluated(evaluation, extraction, verdict, checks, used, dependence(used, len(extraction.logs)))


def _for_recording(robot: CalibratedRobot, extraction: Extraction, params: Path) -> CalibratedRobot:
    """A calibration of odometry for the assumed wheels of a recording.

    Raises:
        ConfigError: only one of them has wheels.
    """
    assumed = extraction.rig.sources.assumed_wheels
    if (robot.odometry is None) != (assumed is None):
        has, lacks = ("wheels", "odometry alone") if robot.odometry is None else ("odometry alone", "wheels")
        raise ConfigError(
            f"{params} is a calibration of {has}, and the recording is read as {lacks}",
            "give a recording with the same topics; with nominal.wheels in rig.yaml odometry is read as wheels",
        )
    return robot if assumed is None else robot.with_assumed(assumed)


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
    small = {
        part: " ".join(small_extents(solution.motion, part == "head", part == "base"))
        for part in ("head", "base")
    }
    return OwnEstimate(own, solution.residuals.leg_reprojection_px, cure, small, found.described)
