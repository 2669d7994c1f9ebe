"""Posture terms by hand."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from zfall.envs.terms.posture import (
    arm_pose,
    double_support_posture,
    reference_posture,
    standing_height,
    survival,
    termination,
    upright,
)
from zfall.robots import ZEROTH01

NONE = TensorDict(batch_size=[1])


def test_survival_and_termination_share_every_step():
    td = TensorDict({"terminated": torch.tensor([[True], [False]])}, batch_size=[2])
    assert survival(NONE, td).squeeze().tolist() == [0.0, 1.0]
    assert termination(NONE, td).squeeze().tolist() == [1.0, 0.0]


def test_upright_falls_by_e_where_one_minus_cosine_is_sigma():
    angle = math.acos(1 - 0.1)
    wxyz = Rotation.from_euler("x", angle).as_quat()[[3, 0, 1, 2]]
    td = TensorDict({"base_orientation": torch.tensor(wxyz)[None]}, batch_size=[1])
    assert upright(NONE, td, sigma=0.1).item() == pytest.approx(math.exp(-1), rel=1e-6)


def test_reference_posture_is_1_there_and_falls_by_e_at_sigma():
    pose = torch.tensor([ZEROTH01.stand_position])
    td = TensorDict({"joint_position": pose.clone()}, batch_size=[1])
    assert reference_posture(NONE, td, robot=ZEROTH01, sigma=0.3).item() == pytest.approx(1.0)
    td["joint_position"][0, 5] += 0.3
    value = reference_posture(NONE, td, robot=ZEROTH01, sigma=0.3).item()
    assert value == pytest.approx(math.exp(-1), rel=1e-5)


def test_posture_counts_in_double_support_alone():
    """0.06 and 0.08 rad off: at a cutoff of 0.1 rad."""
    pose = torch.tensor([ZEROTH01.stand_position]).repeat(3, 1)
    pose[1:, 3] += 0.06
    pose[1:, 8] -= 0.08
    contact = torch.tensor([[True, True], [True, True], [True, False]])
    td = TensorDict({"joint_position": pose, "feet_contact": contact}, batch_size=[3])
    value = double_support_posture(NONE, td, robot=ZEROTH01, cutoff=0.1, epsilon=0.01)
    assert value[:, 0].tolist() == pytest.approx([1.0, 0.01, 0.0], rel=1e-4)


@pytest.mark.parametrize("side", [-1, 1])
def test_standing_height_is_1_there_and_falls_by_e_at_sigma(side):
    heights = torch.tensor([[0.0, 0.0, 0.22], [5.0, 5.0, 0.22 + side * 0.04]])
    td = TensorDict({"com_position": heights}, batch_size=[2])
    value = standing_height(NONE, td, robot=ZEROTH01, sigma=0.04)
    assert value[:, 0].tolist() == pytest.approx([1.0, math.exp(-1)], rel=1e-5)


def test_arms_alone_have_an_arm_pose():
    """Eight joints, four of each arm, each 0.1 rad off."""
    pose = torch.tensor([ZEROTH01.stand_position])
    legs, arms = pose.clone(), pose.clone()
    legs[:, :12] += 0.1
    arms[:, 12:16] += 0.1
    arms[:, 16:] -= 0.1
    for angles, expected in ((pose, 0.0), (legs, 0.0), (arms, 0.8)):
        td = TensorDict({"joint_position": angles}, batch_size=[1])
        assert arm_pose(NONE, td, robot=ZEROTH01).item() == pytest.approx(expected, abs=1e-6)
