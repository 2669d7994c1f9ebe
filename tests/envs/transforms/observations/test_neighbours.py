"""Neighbours of observations: their spread, in an env and in a replay buffer."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.data import LazyTensorStorage, ReplayBuffer

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import CAPSNeighbours, ObservationVector

KEYS = ["projected_gravity", "joint_position"]


def test_neighbours_lie_around_each_observation_by_their_sigma(make_base):
    base = make_base(num_envs=64)
    sigma = {"joint_position": 0.1}
    env = make_env(
        base,
        {
            "action": JointPositionTarget(base, scale=0.5),
            "observation": ObservationVector(keys=KEYS, out_key="observation", measured=False),
            "near": CAPSNeighbours(base, sigma=sigma, keys=KEYS),
        },
    )
    td = env.rollout(10)
    for away in (
        td["observation_neighbour"] - td["observation"],
        td["next", "observation_neighbour"] - td["next", "observation"],
    ):
        assert_close(away[..., :3], torch.zeros_like(away[..., :3]))
        assert away[..., 3:].std().item() == pytest.approx(0.1, rel=0.03)
        assert away[..., 3:].mean().item() == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize("sigma", [0.1, {"joint_position": 0.1}])
def test_their_spread_may_differ_from_world_to_world(make_base, sigma):
    base = make_base(num_envs=2)
    near = CAPSNeighbours(base, sigma=sigma, keys=KEYS)
    (name,) = near.sigma
    near.sigma[name] = torch.tensor([0.0, 0.5])  # as a curriculum sets it
    seen = TensorDict(
        {"projected_gravity": torch.zeros(2, 3), "joint_position": torch.zeros(2, 20)}, [2]
    )
    seen["observation"] = torch.zeros(2, 23)
    drawn = torch.stack([near._call(seen.clone())["observation_neighbour"] for _ in range(200)])
    assert not drawn[:, 0].any()
    assert drawn[:, 1, 3:].std().item() == pytest.approx(0.5, rel=0.05)


def test_a_sigma_by_name_counts_in_each_frame_of_a_stack():
    near = CAPSNeighbours(sigma={"joint_position": 0.1}, keys=KEYS)
    data = {"projected_gravity": torch.zeros(1000, 3), "joint_position": torch.zeros(1000, 20)}
    td = TensorDict({**data, "observation": torch.zeros(1000, 2 * 23)}, [1000])
    frames = near._call(td)["observation_neighbour"].unflatten(-1, (2, 23))
    assert not frames[..., :3].any()
    assert_close(frames[..., 3:].std((0, 2)), torch.full((2,), 0.1), rtol=0.05, atol=0.0)
    td["observation"] = torch.zeros(1000, 24)
    with pytest.raises(ValueError, match=r"keys must be all quantities .* 23 .* 24"):
        near._call(td)


def test_a_replay_buffer_draws_new_ones_with_every_sample():
    buffer = ReplayBuffer(storage=LazyTensorStorage(100), batch_size=1000)
    buffer.append_transform(CAPSNeighbours(sigma=0.3))
    buffer.extend(TensorDict({"observation": torch.zeros(100, 4)}, [100]))
    first, second = buffer.sample(), buffer.sample()
    assert first["observation_neighbour"].std().item() == pytest.approx(0.3, rel=0.05)
    assert not torch.equal(first["observation_neighbour"], second["observation_neighbour"])


@pytest.mark.parametrize(
    ("sigma", "message"),
    [
        (-0.1, "sigma"),
        ({"weather": 0.1}, r"keys \(projected_gravity, joint_position\), got weather"),
    ],
)
def test_faults(sigma, message):
    with pytest.raises(ValueError, match=message):
        CAPSNeighbours(sigma=sigma, keys=KEYS)
