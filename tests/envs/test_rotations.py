"""Quaternions against SciPy's rotations."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from zfall.envs.rotations import rotate, rotate_inverse, tilt, up_axis


@pytest.fixture
def turns() -> tuple[torch.Tensor, Rotation]:
    rotation = Rotation.random(200, random_state=0)
    wxyz = rotation.as_quat()[:, [3, 0, 1, 2]]
    return torch.tensor(wxyz), rotation


def test_rotate_agrees_with_scipy(turns):
    quaternion, rotation = turns
    vector = torch.randn(200, 3, dtype=torch.float64)
    np.testing.assert_allclose(rotate(quaternion, vector), rotation.apply(vector), atol=1e-12)


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


def test_turning_on_the_spot_is_no_tilt():
    wxyz = Rotation.from_euler("z", 77, degrees=True).as_quat()[[3, 0, 1, 2]]
    assert tilt(torch.tensor(wxyz)).item() == pytest.approx(0.0, abs=1e-7)
