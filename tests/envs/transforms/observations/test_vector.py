"""Vectors, and stacks of them."""

import pytest
import torch
from torchrl.envs import CatFrames
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationVector


def vector(make_base, keys: list, *more):
    base = make_base(num_envs=3)
    return make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "observation": ObservationVector(keys=keys, out_key="observation", measured=True),
        **{f"more{i}": transform for i, transform in enumerate(more)},
    })  # fmt: skip


def test_vector_lines_up_flattened_quantities_in_order(make_base):
    env = vector(make_base, ["joint_position", "feet_contact", "feet_position"])
    check_env_specs(env)
    td = env.reset()
    expected = torch.cat(
        [td["joint_position"], td["feet_contact"].float(), td["feet_position"].reshape(3, 6)], -1
    )
    assert torch.equal(td["observation"], expected)


def test_stack_of_the_last_observations_starts_again_where_the_episode_does(make_base):
    """TorchRL's own transform does it; rows of a partial reset are filled with the new start."""
    frames = CatFrames(N=3, dim=-1, in_keys=["observation"], out_keys=["observation"])
    env = vector(make_base, ["joint_position"], frames)
    check_env_specs(env)
    td = env.reset()
    seen = [td["joint_position"]]
    for _ in range(3):
        td["action"] = 0.3 * torch.randn(3, 20)
        td = env.step(td)["next"]
        seen.append(td["joint_position"])
    assert torch.equal(td["observation"], torch.cat(seen[-3:], -1))
    td["_reset"] = torch.tensor([[True], [False], [False]])
    td = env.reset(td)
    start = td["joint_position"]
    assert torch.equal(td["observation"][0], start[0].repeat(3))
    assert torch.equal(td["observation"][1:], torch.cat(seen[-3:], -1)[1:])
    td["action"] = torch.zeros(3, 20)
    td = env.step(td)["next"]
    expected = torch.cat([start, start, td["joint_position"]], -1)[0]
    assert torch.equal(td["observation"][0], expected)


def test_unknown_key_is_refused_with_a_list(make_base):
    with pytest.raises(ValueError, match=r"\(.*joint_position.*\), got joint_positon"):
        vector(make_base, ["joint_positon"])
