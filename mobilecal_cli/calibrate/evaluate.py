"""`mobilecal evaluate`: a calibration evaluated on a recording; and the split that `--hold-out` makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.gaps import require_stations
from mobilecal_cli.calibrate.load import OTHER_ROBOT, is_archive, load, parameters_of, read_params
from mobilecal_cli.errors import ConfigError, MobilecalError, ObservationError, SolveError
from mobilecal_cli.kinematics import unlike_joints
from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.effects import CameraEffect
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.model.solution import Solution
from mobilecal_cli.model.text import listed
from mobilecal_cli.report.evaluation import Evaluated, judge_evaluation
from mobilecal_cli.report.motion import motion_gaps
from mobilecal_cli.report.verdict import evaluated_figures, gate_checks, gates_of
from mobilecal_cli.rig.config import UNCONFIGURED, RigConfig, checked_settings
from mobilecal_cli.rig.settings import board_settings
from mobilecal_cli.solvers import clock_offsets, solve
from mobilecal_cli.solvers import evaluate as evaluate_parameters

#: Kinds of constants that are part of a URDF once they are applied.
_OF_CHAIN = ("joint_zero", "joint_axis", "joint_position")


def evaluate(
    logs: Sequence[Path],
    params: Path,
    *,
    before: Path | None = None,
    config: RigConfig = UNCONFIGURED,
    gates: Sequence[str] = (),
    progress: Progress = silent,
) -> Evaluated:
    """Evaluate a calibration on recordings: its parameters, and its constants of cameras and head.

    Those of the board are the recordings' own, as is the time between the clocks.

    Args:
        logs: recordings of the calibrated robot, or one extraction.npz.
        params: the calibration.
        before: another params.yaml, whose wheels dead reckoning is compared with; by default the nominal wheels.
        config: rig.yaml with the flags that override it.
        gates: `NAME=LIMIT`, over those of the file.
        progress: receives the progress.

    Raises:
        MobilecalError: see `errors`.
    """
    robot = read_params(params)
    limits = gates_of(gates, config.gates, evaluating=True)
    config, notes = _with_board(config, robot, logs, params)
    extraction = load(logs, config, progress).extraction
    if not extraction.legs:
        raise ObservationError(
            f"the board was found at {len(extraction.observations)} stations: an evaluation needs two per recording",
            "give a recording with more stops in front of the board",
        )
    robot, left_out = _but_corrected(_for_recording(robot, extraction, params), extraction)
    earlier = None if before is None else _for_recording(read_params(before), extraction, before)
    parameters = parameters_of(robot, extraction, params)
    progress("solving", 0, None)
    own = _solved(extraction, robot)
    progress("evaluating", 0, None)
    nominal, reference, offsets, cure = extraction.rig.nominal.wheels, None, {}, ""
    constants = dict(robot.constants)
    if isinstance(own, Solution):
        constants |= {c.name: c.value for c in own.constants.values() if c.part == "board"}
        offsets, cure = clock_offsets(own), "; ".join(gap.cure for gap in motion_gaps(extraction))
        # Path length and rotation by wheels that do not come from the calibration under test, if there are any.
        if own.uncertainty is not None and own.uncertainty.observable[6:].all():
            reference = own.parameters.wheels
    evaluation = evaluate_parameters(
        extraction,
        parameters,
        nominal if earlier is None else earlier.wheels,
        offsets_s=offsets,
        reference=reference or nominal,
        constants=constants,
    )
    made_from = {log.sha256 for log in robot.logs}  # a copy has another name
    used = tuple(log.path for log in extraction.logs if log.sha256 in made_from)
    gated = gate_checks(limits, evaluated_figures(evaluation))
    verdict = judge_evaluation(evaluation, extraction, robot, own, cure, used, gated)
    return Evaluated(evaluation, extraction, verdict, used, (*notes, *left_out))


def _with_board(
    config: RigConfig, robot: CalibratedRobot, logs: Sequence[Path], params: Path
) -> tuple[RigConfig, tuple[str, ...]]:
    """The configuration with the calibration's board, if one camera needs it and nothing states it; and a note."""
    board = robot.board
    if board is None or config.board != UNCONFIGURED.board or any(map(is_archive, logs)):
        return config, ()
    settings = board_settings(board, [])
    stated = checked_settings({"board": settings}, f"{params}: provenance.config: ").board
    said = f"{board.columns} x {board.rows} inner corners, squares of {1e3 * settings['square_m']:g} mm"
    note = f"The board is taken as the one of this calibration ({said}); state another one with --set board.square_m."
    return config.model_copy(update={"board": stated}), (note,)


def _but_corrected(robot: CalibratedRobot, extraction: Extraction) -> tuple[CalibratedRobot, tuple[str, ...]]:
    """A calibration without its corrections of what the recording describes otherwise, and a note on each part.

    They are differences from what was stated: a URDF or a camera_info that they were applied to must not be corrected
    again.
    """
    rig, known = extraction.rig, robot.constants
    rows = [row for row in table(rig.cameras, rig.chain) if known.get(row.name)]
    others: dict[str, set[str]] = {}
    if robot.cameras_sha256 not in ("", rig.cameras.digest):
        others["camera infos are"] = {row.name for row in rows if isinstance(row.effect, CameraEffect)}
    if robot.chain is not None and unlike_joints(robot.chain, rig.chain):
        others["head chain is"] = {row.name for row in rows if row.kind in _OF_CHAIN}
    dropped = set[str]().union(*others.values())
    notes = tuple(
        f"The recording's {words} not as this calibration was made with: its corrections of them are left out."
        for words, names in others.items()
        if names
    )
    constants = {name: value for name, value in known.items() if name not in dropped}
    return replace(robot, constants=constants), notes


def _for_recording(robot: CalibratedRobot, extraction: Extraction, params: Path) -> CalibratedRobot:
    """A calibration of odometry for the assumed wheels of a recording.

    Raises:
        ConfigError: only one of them has wheels, or their heads have other joints.
    """
    sources, chain = extraction.rig.sources, extraction.rig.chain
    joints = tuple(name for name in chain.joints if name not in sources.elsewhere)
    if robot.head_joints and joints and set(robot.head_joints) != set(joints):
        raise ConfigError(
            f"{params} is a calibration of another robot: its head has the joints {listed(robot.head_joints)}, "
            f"that of the recording {listed(joints)}",
            "give the calibration of this robot",
        )
    assumed = extraction.rig.sources.assumed_wheels
    if (robot.odometry is None) != (assumed is None):
        has, lacks = ("wheels", "odometry alone") if robot.odometry is None else ("odometry alone", "wheels")
        raise ConfigError(
            f"{params} is a calibration of {has}, and the recording is read as {lacks}",
            f"{OTHER_ROBOT} its topics in rig.yaml; with nominal.wheels odometry is read as wheels",
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
            nominal = rig.nominal.over(Nominal(robot.T_parent_child, robot.wheels))
            return solve(replace(extraction, rig=replace(rig, nominal=nominal)))
    except MobilecalError as error:
        return error
