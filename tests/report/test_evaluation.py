"""The verdict on a calibration: right ones pass, wrong ones fail, and a poor recording decides nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate.evaluate import evaluate
from mobilecal_cli.errors import ConfigError, SolveError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.params import params_yaml
from mobilecal_cli.model.observations import LogSource, WheelTrack
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import Provenance
from mobilecal_cli.solvers import solve
from tests.extractions import Noise, simulated
from tests.report.example import params_of, with_uncertainty

NOISE = Noise(pixel_px=0.2, wheel_rad_per_sqrt_rad=0.005, joint_rad=3e-4)


def extraction(seed):
    made = simulated("standard", NOISE, stations=16, seed=seed)
    return replace(made, logs=(LogSource(f"{seed}.mcap", f"{seed:064}"),))


@cache
def calibrated(seed):
    made = extraction(seed)
    return solve(made), made


def verdict(folder, solution, made, evaluated):
    provenance = Provenance("1", "2026-01-01T00:00:00Z", "ml", made.logs, {})
    (folder / "params.yaml").write_text(params_yaml(solution, made, provenance), encoding="utf-8")
    (folder / "other.npz").write_bytes(extraction_to_npz(evaluated))
    return evaluate([folder / "other.npz"], folder / "params.yaml").verdict


def with_wheels(solution, right=1.0, left=1.0, separation=1.0):
    wheels = WheelGeometry.of(solution.parameters.wheels.vector * [right, left, separation])
    return replace(solution, parameters=replace(solution.parameters, wheels=wheels))


def with_corner_error(solution, px):
    residuals = solution.residuals
    every = np.full_like(residuals.leg_reprojection_px, px)
    residuals = replace(residuals, leg_reprojection_px=every)
    return replace(solution, residuals=residuals, reprojection_rms_px=px)


def with_turned_camera(solution, axis):
    turn = se3.transform(se3.rotation_about(np.array(axis, dtype=float), np.radians(1.0)), np.zeros(3))
    return replace(solution, parameters=replace(solution.parameters, T_h_c=solution.parameters.T_h_c @ turn))


@pytest.fixture
def solved(monkeypatch):
    """The evaluated recording, whose own solution is the same each time."""
    monkeypatch.setattr("mobilecal_cli.calibrate.evaluate.solve", lambda _: calibrated(1)[0])
    return calibrated(1)[1]


def test_another_recording_of_the_same_robot_passes(tmp_path, solved):
    found = verdict(tmp_path, *calibrated(0), solved)
    assert found.level == "PASS", found.reason


def test_a_head_joint_whose_zero_moved_fails(tmp_path, monkeypatch):
    """The nine are the same: the camera is elsewhere in the base. It was PASS, "use params.yaml on the robot"."""
    own, made = calibrated(1)
    moved = replace(own.constants["pan_zero"], value=own.constants["pan_zero"].value + np.radians(1.5))
    own = replace(own, constants={**own.constants, "pan_zero": moved})
    monkeypatch.setattr("mobilecal_cli.calibrate.evaluate.solve", lambda _: own)
    found = verdict(tmp_path, *calibrated(0), made)
    assert found.level == "FAIL"
    assert found.reason.startswith("The camera rotation differs from this recording by 1.")


def test_a_calibration_that_did_not_pass_is_not_to_be_used(tmp_path, solved):
    """It agreed where it says something, and the next step was to use what export refuses."""
    solution, made = calibrated(0)
    (tmp_path / "params.yaml").write_text(
        params_of(solution, made, "NOT ENOUGH", ["The separation is nominal."])
    )
    (tmp_path / "other.npz").write_bytes(extraction_to_npz(solved))
    found = evaluate([tmp_path / "other.npz"], tmp_path / "params.yaml").verdict
    assert found.level == "PASS"
    assert found.next_step == "Calibrate again: this calibration is NOT ENOUGH. The separation is nominal."


@pytest.mark.long
def test_another_recording_passes_with_its_own_solution(tmp_path):
    found = verdict(tmp_path, *calibrated(2), extraction(0))
    assert found.level == "PASS", found.reason


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda s: with_wheels(s, right=1.02), "right wheel radius|corner error"),
        (lambda s: with_wheels(s, right=1.02, left=1.02), "wheel radius|corner error"),
        (lambda s: with_wheels(s, separation=1.04), "wheel separation|corner error"),
        (lambda s: with_wheels(s, right=10, left=10, separation=10), "in meters|corner error"),
        # Corners that are predicted behind the camera.
        (lambda s: with_wheels(s, right=10), "Median station-to-station corner error: > 1000 px;"),
        (lambda s: with_turned_camera(s, [1, 0, 0]), "camera rotation|corner error"),
        (lambda s: with_turned_camera(s, [0, 1, 0]), "camera rotation|corner error"),
        (lambda s: with_turned_camera(s, [0, 0, 1]), "camera rotation|corner error"),
    ],
)
def test_a_wrong_calibration_fails(tmp_path, solved, change, says):
    solution, made = calibrated(0)
    found = verdict(tmp_path, change(solution), made, solved)
    assert found.level == "FAIL"
    assert any(name in found.reason for name in says.split("|")), found.reason


def test_a_mistake_in_the_recording_comes_before_one_in_the_calibration(tmp_path, monkeypatch):
    """A wheel read backwards: "check that params.yaml is of this robot", and the sign in another line."""

    def refused(_):
        raise SolveError("The recording does not fit", "negate wheels.left.sign in rig.yaml")

    monkeypatch.setattr("mobilecal_cli.calibrate.evaluate.solve", refused)
    other = extraction(1)
    tracks = (WheelTrack(t.right, replace(t.left, value=-t.left.value)) for t in other.wheels)
    found = verdict(tmp_path, *calibrated(0), replace(other, wheels=tuple(tracks)))
    assert found.level == "FAIL"
    assert found.next_step.startswith(
        "Negate wheels.left.sign in rig.yaml. Then evaluate again. Check that params"
    )


def test_a_calibration_of_another_head_is_refused(tmp_path):
    solution, made = calibrated(0)
    params = tmp_path / "params.yaml"
    head = {"chain": [{"joint": "neck", "axis": [0, 0, 1]}]}
    provenance = Provenance("1", "2026-01-01T00:00:00Z", "ml", made.logs, {"head": head})
    params.write_text(params_yaml(replace(solution, constants={}), made, provenance), encoding="utf-8")
    (tmp_path / "log.npz").write_bytes(extraction_to_npz(extraction(1)))
    with pytest.raises(ConfigError, match="another robot: its head has the joints"):
        evaluate([tmp_path / "log.npz"], params)


def test_a_short_recording_is_not_enough(tmp_path):
    made = extraction(1)
    short = replace(made, observations=made.observations[:3])
    found = verdict(tmp_path, *calibrated(0), short)
    assert found.level == "NOT ENOUGH"
    assert "both images: 3. Limit: at least 8." in found.reason
    assert found.next_step == "Record at least ten stations."


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda s: with_uncertainty(s, camera=400 * s.uncertainty.camera),
            "This recording gives the camera rotation to ",
        ),
        (
            lambda s: with_uncertainty(s, observable=np.array([False] + [True] * 8)),
            "The camera rotation is unobservable in this recording.",
        ),
        (
            lambda s: with_corner_error(s, 40.0),
            "No parameters explain this recording: the best leave 40.0 px",
        ),
        (None, "This recording cannot be solved by itself: too noisy."),
    ],
)
def test_a_poor_recording_is_not_enough(tmp_path, monkeypatch, change, says):
    """The recording contradicts itself: the calibration is not to blame."""
    own, made = calibrated(1)

    def poor(_):
        if change is None:
            raise SolveError("too noisy", "record again")
        return change(own)

    monkeypatch.setattr("mobilecal_cli.calibrate.evaluate.solve", poor)
    found = verdict(tmp_path, *calibrated(0), made)
    assert found.level == "NOT ENOUGH"
    assert found.reason.startswith(says)
