import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3

numbers = st.floats(-3, 3, allow_subnormal=False)
twists = arrays(np.float64, 6, elements=numbers)
scales = st.sampled_from([1e-9, 1e-6, 1e-3, 0.1, 1.0])


def pose(twist, scale=1.0):
    return se3.exp(scale * twist)


@given(twists, twists, twists)
def test_group_axioms(a, b, c):
    A, B, C = pose(a), pose(b), pose(c)
    assert pytest.approx(A @ (B @ C), abs=1e-12) == (A @ B) @ C
    assert A @ se3.inverse(A) == pytest.approx(np.eye(4), abs=1e-13)
    assert A[:3, :3] @ A[:3, :3].T == pytest.approx(np.eye(3), abs=1e-14)


@given(twists, scales)
def test_log_of_exp(twist, scale):
    twist = scale * twist
    angle = np.linalg.norm(twist[:3])
    if angle > 3.1:
        twist[:3] *= 3.1 / angle
    assert se3.log(se3.exp(twist)) == pytest.approx(twist, rel=1e-11, abs=1e-13)


@given(twists, scales)
def test_exp_against_scipy(twist, scale):
    rotvec = scale * twist[:3]
    R = Rotation.from_rotvec(rotvec)
    assert se3.exp_so3(rotvec) == pytest.approx(R.as_matrix(), abs=1e-14)
    q = R.as_quat()
    assert se3.quaternion_xyzw(R.as_matrix()) == pytest.approx(q * np.sign(q[3] or 1), abs=1e-14)
    assert se3.from_quaternion_xyzw(q) == pytest.approx(R.as_matrix(), abs=1e-14)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.ones(3) / np.sqrt(3)])
def test_half_turns_have_a_logarithm(axis):
    R = 2 * np.outer(axis, axis) - np.eye(3)
    rotvec = se3.log_so3(R)
    assert np.linalg.norm(rotvec) == pytest.approx(np.pi)
    assert se3.exp_so3(rotvec) == pytest.approx(R, abs=1e-14)


@given(twists, twists)
def test_adjoint_carries_twists_across(a, xi):
    A, small = pose(a), 0.1 * xi
    assert A @ se3.exp(small) == pytest.approx(se3.exp(se3.adjoint(A) @ small) @ A, abs=1e-12)


@given(twists)
@settings(max_examples=25)
def test_left_jacobian_against_differences(twist):
    v = twist[:3]
    J = se3.left_jacobian_so3(v)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        difference = se3.log_so3(se3.exp_so3(v + h) @ se3.exp_so3(v - h).T) / 2e-6
        assert J[:, k] == pytest.approx(difference, abs=1e-8)


def test_hand_computed():
    # A quarter turn to the left about z takes x to y; the move (1, 2, 3) is added after it.
    T = se3.transform(se3.rotation_z(np.array(np.pi / 2)), np.array([1.0, 2.0, 3.0]))
    assert se3.act(T, np.array([[1.0, 0.0, 0.0]]))[0] == pytest.approx([1, 3, 3])
    # A quarter circle of radius 1: the twist's translation is its arc length.
    arc = se3.exp(np.array([0, 0, np.pi / 2, np.pi / 2, 0, 0]))
    assert arc[:3, 3] == pytest.approx([1, 1, 0])


def test_euler_angles_as_in_table_1():
    R = Rotation.from_euler("ZYX", [-166.4, 89.38, -164.22], degrees=True).as_matrix()
    assert se3.euler_zyx_deg(R) == pytest.approx((-164.22, 89.38, -166.4), abs=1e-9)
    assert se3.gimbal_margin_deg(R) == pytest.approx(0.62, abs=1e-9)


@pytest.mark.parametrize("pitch", [0.3, np.pi / 2, -np.pi / 2])
def test_angles_give_the_rotation_back_also_at_the_lock(pitch):
    R = se3.from_rpy(np.array([0.4, pitch, -1.1]))
    assert se3.from_rpy(se3.to_rpy(R)) == pytest.approx(R, abs=1e-12)


def test_roll_pitch_yaw_as_urdf_means_them():
    R = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    assert se3.from_rpy(np.array([0.1, 0.2, 0.3])) == pytest.approx(R)


def test_leading_axes_broadcast():
    twists = np.random.default_rng(0).normal(size=(2, 5, 6))
    T = se3.exp(twists)
    assert T.shape == (2, 5, 4, 4)
    assert se3.log(T)[1, 3] == pytest.approx(se3.log(T[1, 3]))
    assert se3.act(T, np.ones((7, 3))).shape == (2, 5, 7, 3)


def test_points_by_a_small_twist():
    points = np.random.default_rng(3).normal(size=(2, 4, 3))
    step = 1e-6
    moved = [se3.act(se3.exp(step * twist), points) for twist in np.eye(6)]
    numeric = (np.stack(moved, axis=-1) - points[..., None]) / step
    np.testing.assert_allclose(se3.by_twist(points), numeric, atol=1e-5)
