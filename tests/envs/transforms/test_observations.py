"""What policy and critic see."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationNoise, ObservationVector

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}


def noisy(make_base, **std: float):
    base = make_base(num_envs=256)
    return make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std=std),
        "observation": ObservationVector(
            keys=["joint_position", "feet_contact", "feet_position"], out_key="observation", measured=True
        ),
        "observation_critic": ObservationVector(
            keys=["joint_position"], out_key="observation_critic", measured=False
        ),
    })  # fmt: skip


def test_noise_has_its_deviation_and_spares_the_truth(make_base):
    env = noisy(make_base, joint_position=0.02)
    check_env_specs(env)
    td = env.reset()
    error = td["observation"][:, :20] - td["joint_position"]
    assert error.std().item() == pytest.approx(0.02, rel=0.06)  # 5120 draws: 5 sigma
    assert abs(error.mean().item()) < 5 * 0.02 / 5120**0.5
    assert_close(td["joint_position"][:, 0], env.base_env.stand_position[0].expand(256))
    assert torch.equal(td["observation_critic"], td["joint_position"])


def test_noise_is_new_at_every_step(make_base):
    env = noisy(make_base, joint_position=0.02)
    td = env.reset()
    first = td["observation"][:, :20] - td["joint_position"]
    td["action"] = torch.zeros(256, 20)
    after = env.step(td)["next"]
    second = after["observation"][:, :20] - after["joint_position"]
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


def test_vector_lines_up_flattened_quantities_in_order(make_base):
    td = noisy(make_base, joint_position=0.0).reset()
    expected = torch.cat(
        [td["joint_position"], td["feet_contact"].float(), td["feet_position"].reshape(256, 6)], -1
    )
    assert torch.equal(td["observation"], expected)


def test_unknown_key_is_refused_with_a_list(make_task):
    vector = ObservationVector(keys=["joint_positon"], out_key="observation", measured=True)
    env = make_task(ACTION)
    env.append_transform(vector)
    with pytest.raises(ValueError, match=r"\(.*joint_position.*\), got joint_positon"):
        _ = env.observation_spec


def test_negative_deviation_is_refused(make_base):
    with pytest.raises(ValueError, match=r"std.joint_position must not be negative, got -0.1"):
        ObservationNoise(make_base(), std={"joint_position": -0.1})
