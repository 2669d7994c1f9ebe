"""A ball launched, and read out of the state."""

import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.ball_state import BallState
from zfall.robots import Ball


def test_a_launched_ball_has_its_new_state_and_no_spin_and_the_others_keep_theirs(make_base):
    simulation = make_base(num_envs=3, ball=Ball(mass=0.2, radius=0.04)).simulation
    simulation.qvel[:, -3:] = 7.0  # what the last throw left
    robot = simulation.qpos[:, :-7].clone()
    ball, before = BallState(simulation.model), simulation.qpos[1, -7:].clone()
    launch, start = torch.tensor([[True], [False], [True]]), torch.randn(3, 6)
    ball.launch(simulation, TensorDict({"ball": {"launch": launch, "start": start}}, [3]))
    seen = ball.read((simulation.qpos, simulation.qvel))
    assert_close(seen["ball", "position"][::2], start[::2, :3])
    assert_close(seen["ball", "velocity"][::2], start[::2, 3:])
    assert simulation.qvel[:, -3:].abs().amax(1).tolist() == [0.0, 7.0, 0.0]
    assert torch.equal(simulation.qpos[1, -7:], before)
    assert torch.equal(simulation.qpos[:, :-7], robot)
