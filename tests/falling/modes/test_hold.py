"""Servos keep their targets once the robot rests."""

import torch
from tensordict import TensorDict

from zfall.envs.transforms.actions import JointVelocityTarget
from zfall.falling.modes import StableHold


def test_targets_are_held_in_stable_alone(make_base):
    env = make_base(num_envs=2)
    hold = StableHold(env)
    mode = torch.tensor([[0.0, 1, 0], [0, 0, 1]])
    first, second = torch.full((2, 20), 0.1), torch.full((2, 20), 0.3)
    kneel = torch.tensor([[0.0, 1, 0], [0, 1, 0]])
    hold._inv_call(TensorDict({"mode": kneel, "target": first}, batch_size=[2]))
    out = hold._inv_call(TensorDict({"mode": mode, "target": second}, batch_size=[2]))["target"]
    assert torch.equal(out, torch.stack([second[0], first[1]]))


def test_targets_of_velocity_stop_in_stable_alone(make_base):
    """A joint at 2 rad/s, for two steps of 0.04 s: the second is held back in the stable world."""
    env = make_base(num_envs=2)
    move, hold = JointVelocityTarget(env, limit=2.0), StableHold(env)
    modes = torch.tensor([[[0.0, 1, 0], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]]])
    action = torch.zeros(2, 20)
    knee = env.robot.joints.index("left_knee_pitch")
    action[:, knee] = -1.0
    begin = env.stand_position[knee]
    for mode in modes:
        td = TensorDict({"mode": mode, "action": action}, batch_size=[2])
        td = hold._inv_call(move._inv_call(td))
    went, lead = td["control"][..., knee] - begin, 2.0 * env.servo_time_constant[knee]
    assert torch.allclose(went[0, [0, -1]], torch.tensor([-0.08, -0.152]) - lead, atol=1e-6)
    assert torch.allclose(went[1], torch.tensor(-0.08), atol=1e-6)
    assert torch.allclose(td["target"][:, knee] - begin, torch.tensor([-0.16, -0.08]), atol=1e-6)
    move._step(td, TensorDict(batch_size=[2]))
    after = move._inv_call(TensorDict({"action": action}, batch_size=[2]))  # back in RECOVER
    assert torch.allclose(after["target"][:, knee] - begin, torch.tensor([-0.24, -0.16]), atol=1e-6)


def test_what_is_held_is_forgotten_at_a_reset(make_base):
    """An episode that begins in STABLE holds the joints where it puts them, world 1's alone."""
    env = make_base(num_envs=2)
    hold, stable = StableHold(env), torch.tensor([[0.0, 0, 1]] * 2)
    places = torch.full((2, 20), 0.2)
    reset = TensorDict({"_reset": torch.tensor([[False], [True]])}, batch_size=[2])
    hold._reset(reset, TensorDict({"joint_position": places}, batch_size=[2]))
    td = TensorDict({"mode": stable, "target": torch.zeros(2, 20)}, batch_size=[2])
    assert torch.equal(hold._inv_call(td)["target"], torch.stack([env.stand_position, places[1]]))


def test_what_is_held_from_the_begin_is_the_target_of_the_start(make_base):
    """Where the start says what the servos followed; NaN: nobody knows, the joints stay."""
    env = make_base(num_envs=2)
    hold, stable = StableHold(env), torch.tensor([[0.0, 0, 1]] * 2)
    places, followed = torch.full((2, 20), 0.2), torch.full((2, 20), 0.3)
    followed[1] = torch.nan
    begin = TensorDict({"start": {"target": followed}}, batch_size=[2])
    hold._reset(begin, TensorDict({"joint_position": places}, batch_size=[2]))
    td = TensorDict({"mode": stable, "target": torch.zeros(2, 20)}, batch_size=[2])
    assert torch.equal(hold._inv_call(td)["target"], torch.stack([followed[0], places[1]]))
