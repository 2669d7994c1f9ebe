"""The standing pose by hand from joint offsets, and from the env."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from zfall.robots import ZEROTH01
from zfall.rotations import rotation_vector
from zfall.simulation.stance import stance


def test_feet_stand_side_by_side_and_level():
    """A right foot 13.6 cm to the right of the left one, as a level rectangle each."""
    pose = stance(ZEROTH01)
    assert_close(pose.feet_offset, torch.tensor([0.0, -0.1360, 0.0]), atol=3e-4, rtol=0)
    assert rotation_vector(pose.feet_turn).norm() < 1e-6


def test_geometry_is_that_of_the_env_after_a_reset(make_base):
    """The keyframe looks along x. The feet look 0.0008 rad to the side, hence the rotation."""
    td = make_base(num_envs=1).reset()
    pose = stance(ZEROTH01)
    com = td["com_position"] - td["base_position"]
    assert_close(pose.com, com[0, :2], atol=1e-6, rtol=0)
    apart = td["feet_position"][0, 1] - td["feet_position"][0, 0]
    mean = Rotation.from_quat(td["feet_orientation"][0].numpy()[:, [1, 2, 3, 0]]).mean()
    np.testing.assert_allclose(pose.feet_offset, mean.inv().apply(apart), atol=1e-6)
