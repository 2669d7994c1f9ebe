"""Effort terms by hand."""

import torch
from tensordict import TensorDict

from zfall.envs.terms.effort import action_rate, joint_torque


def test_action_rate_is_the_squared_change():
    td = TensorDict(
        {"action": torch.tensor([[1.0, 2.0]]), "last_action": torch.tensor([[0.0, 4.0]])},
        batch_size=[1],
    )
    assert action_rate(td, td).item() == 5.0


def test_joint_torque_is_the_sum_of_squares():
    td = TensorDict({"joint_torque": torch.tensor([[3.0, -4.0]])}, batch_size=[1])
    assert joint_torque(td, td).item() == 25.0
