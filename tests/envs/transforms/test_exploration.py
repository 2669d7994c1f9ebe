"""Noise that lasts longer than a step."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.exploration import CorrelatedNoise
from zfall.envs.transforms.terminations import time_limit

TASK = {
    "action": (JointPositionTarget, {"scale": 0.1}),
    "limit": (time_limit, {"seconds": 0.24}),
}


def noise_of(env, steps: int) -> torch.Tensor:
    """What each step began with ``(T, N, J)``, episodes of six steps."""
    td, seen = env.reset(), []
    for _ in range(steps):
        seen.append(td["exploration_noise"])
        td["action"] = torch.zeros(env.num_envs, 20)
        _, td = env.step_and_maybe_reset(td)
    return torch.stack(seen)


@pytest.mark.parametrize("correlation", [0.0, 0.85])
def test_it_is_standard_in_every_step_and_correlated_by_a_power_of_the_distance(
    make_task, correlation
):
    """c^k between steps k apart in an episode, nothing between episodes; of 5120 values each."""
    env = make_task(TASK | {"noise": (CorrelatedNoise, {"correlation": correlation})}, num_envs=256)
    check_env_specs(env)
    noise = noise_of(env, 12).flatten(1)
    assert noise.mean(1).abs().max() < 5 / 5120**0.5
    assert (noise.std(1) - 1).abs().max() < 5 / (2 * 5120) ** 0.5
    told = noise @ noise.T / noise.shape[1]
    step = torch.arange(12)
    apart, same = (step[:, None] - step).abs(), (step[:, None] // 6) == (step // 6)
    expected = torch.where(same, torch.tensor(correlation) ** apart, 0.0)
    torch.testing.assert_close(told, expected, rtol=0, atol=5 * (2 / 5120) ** 0.5)


def test_worlds_that_go_on_keep_their_noise(make_base):
    env = make_base(num_envs=3)
    noise = CorrelatedNoise(env, correlation=0.9)
    before = noise._call(TensorDict(batch_size=[3]))["exploration_noise"]
    reset = TensorDict({"_reset": torch.tensor([[False], [True], [False]])}, [3])
    after = noise._reset(reset, TensorDict(batch_size=[3]))["exploration_noise"]
    assert (after == before).all(1).tolist() == [True, False, True]


@pytest.mark.parametrize("correlation", [-0.1, 1.0])
def test_what_is_no_correlation_is_refused(make_base, correlation):
    with pytest.raises(ValueError, match=rf"correlation must lie in \[0, 1\), got {correlation}"):
        CorrelatedNoise(make_base(), correlation=correlation)
