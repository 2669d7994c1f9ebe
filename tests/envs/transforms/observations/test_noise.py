"""White noise on what is measured."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import StepCounter
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationNoise, ObservationVector
from zfall.envs.transforms.rewards import WeightedReward


def noisy(make_base, **std: float):
    base = make_base(num_envs=256)
    return make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std=std),
        "observation": ObservationVector(
            keys=["joint_position"], out_key="observation", measured=True
        ),
        "observation_critic": ObservationVector(
            keys=["joint_position"], out_key="observation_critic", measured=False
        ),
    })  # fmt: skip


def test_noise_has_its_deviation_and_spares_the_truth(make_base):
    env = noisy(make_base, joint_position=0.02)
    check_env_specs(env)
    td = env.reset()
    error = td["observation"] - td["joint_position"]
    assert error.std().item() == pytest.approx(0.02, rel=0.06)  # 5120 draws: 5 sigma
    assert abs(error.mean().item()) < 5 * 0.02 / 5120**0.5
    assert_close(td["joint_position"][:, 0], env.base_env.stand_position[0].expand(256))
    assert torch.equal(td["observation_critic"], td["joint_position"])


def test_uniform_noise_fills_its_width_evenly(make_base, measure):
    noise = ObservationNoise(make_base(num_envs=256), uniform={"joint_position": 0.05})
    error = measure(noise, joint_position=torch.zeros(256, 20))
    assert error.abs().max() <= 0.05
    assert error.abs().max() > 0.0499
    assert error.std().item() == pytest.approx(0.05 / 3**0.5, rel=0.05)
    assert abs(error.mean().item()) < 5 * 0.05 / 3**0.5 / 5120**0.5


def test_noise_is_new_at_every_step(make_base, measure):
    noise = ObservationNoise(make_base(num_envs=256), std={"joint_position": 0.02})
    first, second = (measure(noise, joint_position=torch.zeros(256, 20)) for _ in range(2))
    correlation = (first * second).mean() / (first.std() * second.std())
    assert abs(correlation.item()) < 5 / 5120**0.5


def test_two_noises_add_in_variance(make_base):
    base = make_base(num_envs=256)
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "one": ObservationNoise(base, std={"joint_position": 0.03}),
        "two": ObservationNoise(base, std={"joint_position": 0.04}),
    })  # fmt: skip
    td = env.reset()
    error = td["measured", "joint_position"] - td["joint_position"]
    assert error.std().item() == pytest.approx(0.05, rel=0.06)


@pytest.mark.parametrize("noise_first", [True, False])
def test_reward_reads_the_truth_wherever_the_noise_stands(make_base, noise_first):
    base = make_base(num_envs=2)

    def first_joint(td, next_td):
        return next_td["joint_position"][:, :1]

    reward = WeightedReward(base, terms={"joint": [1.0, first_joint]})
    noise = ObservationNoise(base, std={"joint_position": 10.0})
    table = (
        {"noise": noise, "reward": reward} if noise_first else {"reward": reward, "noise": noise}
    )
    action = JointPositionTarget(base, scale=1.0)
    env = make_env(base, {"action": action, **table, "limit": StepCounter(max_steps=5)})
    td = env.rollout(5)
    assert_close(td["next", "reward"], td["next", "joint_position"][..., :1])
    assert td["next", "measured", "joint_position"].abs().max() > 5.0


def test_deviation_of_each_world_acts_there(make_base, measure):
    noise = ObservationNoise(make_base(num_envs=256), std={"joint_position": 0.0})
    noise.std["joint_position"] = torch.where(torch.arange(256) < 128, 0.0, 1.0)
    error = measure(noise, joint_position=torch.zeros(256, 20))
    assert (error[:128] == 0).all()
    assert error[128:].std().item() == pytest.approx(1.0, rel=0.08)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"std": {"joint_position": -0.1}}, r"std.joint_position must not be negative, got -0.1"),
        ({"uniform": {"target": -1.0}}, r"uniform.target must not be negative, got -1.0"),
        ({}, r"std or uniform must name at least one key, got none"),
    ],
)
def test_bad_value_is_refused_by_name_and_rule(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        ObservationNoise(make_base(), **values)


def test_unknown_key_is_refused_with_a_list(make_task):
    action = (JointPositionTarget, {"scale": 1.0})
    table = {"action": action, "noise": (ObservationNoise, {"std": {"joint_positon": 1.0}})}
    with pytest.raises(
        ValueError, match=r"std must name .*\(.*joint_position.*\), got joint_positon"
    ):
        make_task(table)
