"""Quaternions against SciPy's rotations."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from zfall.rotations import (
    cos_tilt,
    from_angles,
    from_rotation_vector,
    heading,
    mean_orientation,
    roll_and_pitch,
    rotate,
    rotate_inverse,
    rotation_angle,
    rotation_vector,
    tilt,
    turn_between,
    turn_to_heading,
    turned,
    up_axis,
    wrap,
)


@pytest.fixture
def turns() -> tuple[torch.Tensor, Rotation]:
    rotation = Rotation.random(200, random_state=0)
    wxyz = rotation.as_quat()[:, [3, 0, 1, 2]]
    return torch.tensor(wxyz), rotation


def wxyz(rotation: Rotation) -> np.ndarray:
    return np.atleast_2d(rotation.as_quat())[:, [3, 0, 1, 2]]


def test_rotate_agrees_with_scipy(turns):
    quaternion, rotation = turns
    vector = torch.randn(200, 3, dtype=torch.float64)
    np.testing.assert_allclose(rotate(quaternion, vector), rotation.apply(vector), atol=1e-12)


def test_turned_agrees_with_scipy(turns):
    quaternion, rotation = turns
    angle = torch.linspace(-4.0, 4.0, 200, dtype=torch.float64)
    expected = (Rotation.from_euler("z", angle[:, None]) * rotation).as_matrix()
    found = Rotation.from_quat(turned(quaternion, angle)[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_rotate_inverse_agrees_with_scipy(turns):
    quaternion, rotation = turns
    vector = torch.randn(200, 3, dtype=torch.float64)
    expected = rotation.inv().apply(vector)
    np.testing.assert_allclose(rotate_inverse(quaternion, vector), expected, atol=1e-12)


def test_up_axis_is_world_up_in_the_body(turns):
    quaternion, rotation = turns
    expected = rotation.inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up_axis(quaternion), expected, atol=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 0.01, 30.0, 90.0, 179.99])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_tilt_is_the_angle_of_a_turn_about_a_level_axis(axis, degrees):
    wxyz = Rotation.from_euler(axis, degrees, degrees=True).as_quat()[[3, 0, 1, 2]]
    assert torch.rad2deg(tilt(torch.tensor(wxyz))).item() == pytest.approx(degrees, abs=1e-5)


def test_cosine_of_the_tilt_is_the_last_entry_of_the_rotation_matrix(turns):
    quaternion, rotation = turns
    np.testing.assert_allclose(
        cos_tilt(quaternion)[..., 0], rotation.as_matrix()[:, 2, 2], atol=1e-12
    )


def test_turning_on_the_spot_is_no_tilt():
    wxyz = Rotation.from_euler("z", 77, degrees=True).as_quat()[[3, 0, 1, 2]]
    assert tilt(torch.tensor(wxyz)).item() == pytest.approx(0.0, abs=1e-7)


def test_heading_roll_and_pitch_are_the_intrinsic_angles_about_z_y_x(turns):
    quaternion, rotation = turns
    angles = torch.cat([heading(quaternion), roll_and_pitch(up_axis(quaternion)).flip(-1)], -1)
    np.testing.assert_allclose(angles, rotation.as_euler("ZYX"), atol=1e-10)


def test_turn_between_is_the_second_seen_from_the_first(turns):
    quaternion, rotation = turns
    turn = turn_between(quaternion[:-1], quaternion[1:])
    expected = (rotation[:-1].inv() * rotation[1:]).as_matrix()
    found = Rotation.from_quat(turn.numpy()[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_rotation_vector_is_the_logarithm_whatever_the_sign_of_the_quaternion(turns):
    quaternion, rotation = turns
    for sign in (1, -1):
        vector = rotation_vector(sign * quaternion)
        np.testing.assert_allclose(vector, rotation.as_rotvec(), atol=1e-10)
        angle = rotation_angle(sign * quaternion)[:, 0]
        np.testing.assert_allclose(angle, rotation.magnitude(), atol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-7, 1e-4, 3.14])
def test_rotation_vector_of_small_and_large_turns_in_float32(angle):
    turn = torch.tensor(wxyz(Rotation.from_rotvec([0.0, angle, 0.0]))).float()
    np.testing.assert_allclose(rotation_vector(turn)[0, 1], angle, rtol=1e-5, atol=1e-12)


def test_from_rotation_vector_is_the_exponential(turns):
    quaternion, rotation = turns
    found = from_rotation_vector(torch.tensor(rotation.as_rotvec()))
    sign = torch.where(quaternion[:, :1] < 0, -1, 1)  # the shorter way round
    np.testing.assert_allclose(found, sign * quaternion, atol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-7, 1e-4, 3.14])
def test_from_rotation_vector_and_back_in_float32(angle):
    vector = torch.tensor([[0.0, angle, 0.0]])
    np.testing.assert_allclose(rotation_vector(from_rotation_vector(vector)), vector, rtol=1e-5)


def test_mean_orientation_is_halfway(turns):
    quaternion, rotation = turns
    mean = mean_orientation(quaternion[:-1], -quaternion[1:]).numpy()
    for i in range(50):
        expected = Slerp([0.0, 1.0], rotation[i : i + 2])(0.5).as_matrix()
        found = Rotation.from_quat(mean[i, [1, 2, 3, 0]]).as_matrix()
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_level_vector_is_seen_along_the_heading_alone():
    """Heading 90 degrees: what lies ahead in the world (x) lies to the right (-y)."""
    turn = torch.tensor(wxyz(Rotation.from_euler("ZYX", [90, 20, -30], degrees=True)))
    seen = turn_to_heading(turn, torch.tensor([[2.0, 0.5]], dtype=torch.float64))
    np.testing.assert_allclose(seen, [[0.5, -2.0]], atol=1e-12)


def test_wrapped_angle_means_the_same_and_lies_within_half_a_turn():
    angle = torch.tensor([0.1, 3.5, -3.5, 7.0, -20.0])
    wrapped = wrap(angle)
    assert (wrapped.abs() <= torch.pi).all()
    np.testing.assert_allclose(wrapped.cos(), angle.cos(), atol=1e-5)
    np.testing.assert_allclose(wrapped.sin(), angle.sin(), atol=1e-5)


def test_angles_give_back_the_orientation(turns):
    quaternion, rotation = turns
    angles = torch.tensor(rotation.as_euler("ZYX")).flip(-1)  # roll, pitch, heading
    again = from_angles(angles)
    sign = torch.sign((again * quaternion).sum(-1, keepdim=True))  # both mean the same
    np.testing.assert_allclose(sign * again, quaternion, atol=1e-10)
