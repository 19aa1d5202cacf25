import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.solvers.linear import head_eye_rotation


def pairs(R_X, count, random, angle=0.6):
    R_head = Rotation.from_rotvec(random.normal(scale=angle, size=(count, 3))).as_matrix()
    return R_head, np.swapaxes(R_X, -1, -2) @ R_head @ R_X


@given(st.integers(0, 2**32 - 1))
def test_exact_rotations_are_recovered(seed):
    random = np.random.default_rng(seed)
    R_X = Rotation.random(random_state=seed % 2**31).as_matrix()
    found, singular = head_eye_rotation(*pairs(R_X, 5, random))
    assert found == pytest.approx(R_X, abs=1e-10)
    assert singular[3] < 1e-12


@pytest.mark.parametrize("axis", [*np.eye(3), np.ones(3) / np.sqrt(3)])
def test_a_half_turn_is_no_singularity(axis):
    R_X = 2 * np.outer(axis, axis) - np.eye(3)
    found, _ = head_eye_rotation(*pairs(R_X, 6, np.random.default_rng(3)))
    assert found == pytest.approx(R_X, abs=1e-12)


def test_two_pairs_are_enough_if_their_axes_differ():
    R_X = Rotation.from_euler("ZYX", [-166.4, 89.38, -164.22], degrees=True).as_matrix()
    found, _ = head_eye_rotation(*pairs(R_X, 2, np.random.default_rng(0)))
    assert found == pytest.approx(R_X, abs=1e-12)
    R_X = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    R_head = Rotation.from_rotvec(np.outer([0.2, 0.5, -0.3, 0.9], [0, 0, 1])).as_matrix()
    _, singular = head_eye_rotation(R_head, R_X.T @ R_head @ R_X)
    assert singular[2] < 1e-12


def test_a_real_arm_and_camera(shared_data):
    """50 pairs that MoveIt published; the answers are theirs (eulerAngles(0, 1, 2) of their solver)."""
    folder = "handeye/moveit_calibration/moveit_calibration_plugins/handeye_calibration_solver/test"
    path = shared_data / folder / "pose_samples.json"
    samples = np.array(json.loads(path.read_text()))
    T_base_hand, T_cam_target = samples[:, 0], samples[:, 1]
    i, j = np.triu_indices(len(samples), 1)
    # The camera stands beside the arm and the hand holds the target, so the arm's motion enters inverted.
    hand = T_base_hand[i] @ se3.inverse(T_base_hand[j])
    camera = T_cam_target[i] @ se3.inverse(T_cam_target[j])
    R_X, _ = head_eye_rotation(hand[:, :3, :3], camera[:, :3, :3])
    published = Rotation.from_euler("XYZ", [0.230, -2.540, 1.950]).as_matrix()
    apart = np.degrees(np.linalg.norm(se3.log_so3(published.T @ R_X)))
    assert apart < 0.5  # their figures are rounded to 0.01 rad
    right_side = np.einsum("ab,nb->na", R_X, camera[:, :3, 3]) - hand[:, :3, 3]
    t_X = np.linalg.lstsq((hand[:, :3, :3] - np.eye(3)).reshape(-1, 3), right_side.ravel())[0]
    assert t_X == pytest.approx([0.6595, -0.2500, 0.8304], abs=5e-4)
