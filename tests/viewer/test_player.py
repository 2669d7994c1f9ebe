"""What the viewer's robots do, without a browser."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.evaluation.candidate import load_candidate
from zfall.viewer.player import Player

ALL = torch.ones(1, dtype=torch.bool)


def player(name="limp", num_envs=1):
    return Player(load_candidate(name), num_envs)


@pytest.mark.parametrize("duration", [0.1, 0.05])
def test_a_push_changes_the_momentum_by_its_impulse(duration):
    """Limp in the air, where nothing else but gravity acts: J = m v, to 1 %."""
    limp = player()
    simulation = limp.env.base_env.simulation
    simulation.qpos[:, 2] += 1.0  # free fall for a fifth of a second, then 0.8 m are left
    simulation.qvel[:] = 0.0
    before = momentum(limp)
    limp.push(ALL, "torso", torch.tensor([0.5, -1.0, 0.0]), duration)
    for _ in range(4):
        limp.step()
    assert_close(momentum(limp)[:2] - before[:2], torch.tensor([0.5, -1.0]), rtol=0.01, atol=0.01)


def momentum(one):
    one.env.base_env._observed  # noqa: B018
    return one.seen["linear_momentum"][0]


def test_modes_have_the_names_of_the_transform_that_switches_them():
    assert player("pose_hold").mode(0) is None
    kneels = player("kneel", 2)
    assert kneels.mode(0) == "recover"
    kneels.push(torch.tensor([False, True]), "torso", torch.tensor([10.0, 0.0, 0.0]), 0.1)
    for _ in range(10):
        kneels.step()
    assert [kneels.mode(world) for world in (0, 1)] == ["recover", "kneel"]
    kneels.seen["mode"] = torch.tensor([[0, 0, 0, 1], [0, 0, 0, 1]])  # as with a way to get up
    assert kneels.mode(0) == "rise"


def test_only_the_worlds_that_are_meant_are_pushed():
    still = player("pose_hold", 2)
    still.push(torch.tensor([False, True]), "torso", torch.tensor([0.0, 24.6, 0.0]), 0.1)
    still.step()
    assert_close(still.seen["push", "force"][:, 1], torch.tensor([0.0, 246.0]))


def test_a_reset_ends_a_push_and_stands_the_robot_up():
    still = player("pose_hold", 2)
    still.push(torch.tensor([True, True]), "torso", torch.tensor([0.0, 49.0, 0.0]), 0.1)
    for _ in range(40):
        still.step()
    assert still.fell.all()
    still.reset(torch.tensor([True, False]))
    still.step()
    assert still.fell.tolist() == [False, True]
    upright = -still.seen["projected_gravity"][:, 2]  # the cosine of the tilt
    assert upright[0] > 0.95 > 0.6 > upright[1]
    assert (still.seen["push", "force"] == 0).all()


def test_sliders_of_the_world_reach_the_physics():
    """A load adds its mass, a slope turns gravity, a name that is left out is nominal again."""
    still = player("pose_hold")
    base = still.env.base_env
    still.set_physics({"payload": 0.5, "slope": 0.1, "foot_friction": 0.4})
    assert_close(base.parameters.mass, torch.tensor([[base.mass + 0.5]]), atol=1e-4, rtol=0)
    assert_close(base.parameters.gravity[0, 0], torch.tensor(0.1).sin())
    assert base.parameters.values["foot_friction"] == 0.4
    still.set_physics({})
    assert base.parameters.values["foot_friction"] == 1.0
    assert base.parameters.values["payload"].sum() == 0


def test_what_was_chosen_outlasts_a_draw_and_leaves_the_others_alone():
    still = player("pose_hold")
    base = still.env.base_env
    drawn = {
        "foot_friction": torch.full((1, 1), 0.9),
        "servo_torque_limit": torch.full((1, 20), 0.8),
    }
    base.set_physics_params(TensorDict(drawn, [1]))
    still.set_physics({"foot_friction": 0.4})
    assert_close(base.parameters.values["servo_torque_limit"], drawn["servo_torque_limit"])
    base.set_physics_params(TensorDict(drawn, [1]))  # as a reset of the twin would
    still.reset()
    assert base.parameters.values["foot_friction"] == 0.4


def test_latency_lets_commands_come_later():
    """With 40 ms, a whole control step, the first targets do not move the joints yet."""
    quick, late = player("best"), player("best")
    late.set_latency(0.04)
    first = late.seen["joint_position"]  # until then the angles at the reset are held
    quick.step()
    late.step()
    assert_close(late.seen["target"], quick.seen["target"])
    moved = [(each.seen["joint_position"] - first).abs().max() for each in (quick, late)]
    assert moved[1] < 0.5 * moved[0]
