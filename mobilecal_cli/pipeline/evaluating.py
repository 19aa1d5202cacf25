"""`mobilecal evaluate`: a calibration tried on a recording; and the part of a recording that is held out for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mobilecal_cli import se3
from mobilecal_cli.config import load_rig
from mobilecal_cli.errors import ConfigError, ObservationError
from mobilecal_cli.export import parameters_from_yaml
from mobilecal_cli.model import CalibratedRobot, Evaluation, Extraction, Parameters
from mobilecal_cli.pipeline.loading import load
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.report import Check, evaluated_figures, gate_checks, gates_of, reference_frame
from mobilecal_cli.solvers import evaluate as evaluate_parameters
from mobilecal_cli.yaml_input import LARGEST_BYTES, read_text

#: Two legs between held-out stations are the least that say anything.
_LEAST_HELD_OUT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """What an evaluation gave.

    Attributes:
        evaluation: the figures.
        extraction: what it was tried on.
        checks: its gates.
    """

    evaluation: Evaluation
    extraction: Extraction
    checks: tuple[Check, ...]


def read_params(path: Path) -> CalibratedRobot:
    """Read a params.yaml.

    Raises:
        ConfigError: the file cannot be read, or is no params.yaml.
    """
    try:
        text = read_text(path, LARGEST_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(
            f"{path}: cannot be read: {reason}", "give a params.yaml that mobilecal wrote"
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
    """Try a calibration on recordings.

    Args:
        logs: recordings of the calibrated robot, or one extraction.npz.
        params: the calibration.
        before: another params.yaml, whose wheels dead reckoning is compared with; the nominal wheels by default.
        config_path: rig.yaml.
        flags: dotted key → value, over the file.
        gates: `NAME=LIMIT`, over those of the file.
        progress: told how far it is.

    Raises:
        MobilecalError: see `errors`.
    """
    robot = read_params(params)
    config = load_rig(config_path, flags)
    asked = gates_of(gates, config.gates, evaluating=True)
    wheels = read_params(before).wheels if before is not None else None
    extraction, _ = load(logs, config, config_path, flags or {}, progress)
    if len(extraction.wheels) == len(extraction.observations) or len(extraction.observations) < 2:
        raise ObservationError(
            f"the board was found at {len(extraction.observations)} stations: a calibration is tried from one to "
            "the next",
            "give a recording with more stops in front of the board",
        )
    parameters = parameters_of(robot, extraction, params)
    progress("evaluating", 0, None)
    found = evaluate_parameters(extraction, parameters, wheels or extraction.rig.nominal.wheels)
    return Evaluated(found, extraction, tuple(gate_checks(asked, evaluated_figures(found))))


def parameters_of(robot: CalibratedRobot, extraction: Extraction, path: Path) -> Parameters:
    """A calibration's numbers for the left camera of a recording's robot.

    Raises:
        ConfigError: it is of other frames.
    """
    cameras = extraction.rig.cameras
    here = (extraction.rig.chain.head_frame, reference_frame(cameras))
    if (robot.parent_frame, robot.child_frame) != here:
        raise ConfigError(
            f"{path} says where {robot.child_frame!r} is on {robot.parent_frame!r}; in the recording the camera is "
            f"{here[1]!r} and the head {here[0]!r}",
            "set head.head_frame and cameras.reference as the calibration had them",
        )
    return Parameters(robot.T_parent_child @ se3.inverse(cameras.T_c_reference), robot.wheels)


def held_out(extraction: Extraction, share: float) -> tuple[Extraction, Extraction]:
    """A recording without its last stations, and these: the last share of every log's.

    Raises:
        ObservationError: too few would be held out.
    """
    last: set[int] = set()
    for log in range(len(extraction.wheels)):
        members = [n for n, o in enumerate(extraction.observations) if o.log == log]
        last |= set(members[len(members) - math.ceil(share * len(members)) :])
    if len(last) < _LEAST_HELD_OUT:
        raise ObservationError(
            f"--hold-out {share:g} leaves {len(last)} of {len(extraction.observations)} stations to try the "
            f"calibration on, {_LEAST_HELD_OUT} are the least",
            "hold out a larger share, or record more stops",
        )
    looked = extraction.counts.get("stations", 0)
    kept = tuple(o for n, o in enumerate(extraction.observations) if n not in last)
    tried = tuple(o for n, o in enumerate(extraction.observations) if n in last)
    counts = {**extraction.counts, "stations": looked - len(tried)} if looked else extraction.counts
    return replace(extraction, observations=kept, counts=counts), replace(extraction, observations=tried)
