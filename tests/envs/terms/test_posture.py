"""Posture terms by hand."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from zfall.envs.robots import ZEROTH01
from zfall.envs.terms.posture import reference_posture, survival, termination, upright

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
