"""A policy that does around another pose what it did around its own."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall import checkpoint
from zfall.configs import compose_config
from zfall.modules.actors import normalizer_of
from zfall.policies import load_policy
from zfall.policies.load import policy_of
from zfall.robots import ZEROTH01
from zfall.training.build import build_critic
from zfall.training.learner import Learner
from zfall.training.shifted_pose import ShiftedPose
from zfall.training.warm_start import warm_start

SCALE = 0.6  # of an action [rad]
LAST = "+env.transforms.last={_target_: zfall.envs.transforms.windows.LastAction, before: noise}"
PAST = (
    "+env.transforms.past={_target_: zfall.envs.transforms.observations.ObservationHistory, "
    "keys: [joint_position], steps: 2, before: observation}"
)
SEEN = (
    "env.transforms.observation.keys=[projected_gravity,joint_position,joint_velocity,target,"
    "last_action,[history,joint_position]]"
)
OFFSETS = {"left_knee_pitch": 0.4, "right_elbow_roll": -0.1}  # [rad]
ANGLES = torch.tensor([OFFSETS.get(name, 0.0) for name in ZEROTH01.joints])
NONE, VELOCITIES = torch.zeros(3), torch.zeros(20)
MOVED = torch.cat([NONE, ANGLES, VELOCITIES, ANGLES, ANGLES / SCALE, ANGLES, ANGLES])


def config_of(*overrides: str):
    small = ["num_envs=2", "rollout_steps=2", "minibatches=1"]
    return compose_config([*small, LAST, PAST, SEEN, *overrides])


def learned(*overrides: str) -> Learner:
    """A learner whose networks are random, as if it had learned something."""
    learner = Learner(config_of(*overrides))
    torch.manual_seed(0)
    for network in (learner.actor, learner.policy, learner.critic):
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.2)
        for name, buffer in network.named_buffers():
            if name.endswith(("mean", "variance")):
                torch.nn.init.uniform_(buffer, 0.5, 1.0)
    return learner


def shifted(learner: Learner, folder, offsets=OFFSETS):
    """The files of the policy and of the moved one."""
    old, new = folder / "old.pt", folder / "new.pt"
    checkpoint.save(old, learner.state_dict())
    ShiftedPose(run=str(old), offsets=offsets).make(new, console=None)
    return old, new


@pytest.mark.parametrize("actor", ["mlp_gaussian", "gru_mog", "gru_shared_mog"])
def test_it_acts_and_judges_in_the_new_pose_as_it_did_in_the_old(actor, tmp_path):
    """``a'(o + d) = a(o) + d``, by joint; the memory goes the same way, and the critic's value."""
    learner = learned(f"actor={actor}")
    old, new = shifted(learner, tmp_path)
    torch.manual_seed(1)
    td, seen = load_policy(old).env(3).reset(), torch.randn(3, len(MOVED))
    for name in ("actor", "policy"):
        # Which of the two a file's policy is read from does not matter: both are moved.
        before, after = (
            policy_of({**content, "policy": content[name]}, learner.cfg.env, path)
            for path in (old, new)
            for content in [checkpoint.load(path)]
        )
        state = td.clone()
        for _ in range(2):  # the second time with a memory
            one = before(state.clone().set("observation", seen))
            other = after(state.clone().set("observation", seen + MOVED))
            assert_close(other["action"], one["action"] + ANGLES / SCALE, atol=1e-4, rtol=1e-5)
            for key in before.out_keys:
                if isinstance(key, tuple):
                    assert_close(other[key], one[key])
                    state[key[1]] = one[key]

    critic = build_critic(learner.cfg, learner.env, after)
    critic.load_state_dict(checkpoint.load(new)["critic"])
    spec = learner.env.observation_spec["observation_critic"]
    judged = TensorDict({"observation_critic": torch.randn(2, spec.shape[-1])}, [2])
    value = learner.critic(judged.clone())["state_value"]
    judged["observation_critic"] += _moved_critic(learner)
    assert_close(critic(judged)["state_value"], value)


def _moved_critic(learner: Learner) -> torch.Tensor:
    """What the critic sees of joint angles, moved: found by the names of what it is shown."""
    parts, moved = [], {"joint_position": ANGLES, "target": ANGLES}
    for key in learner.cfg.env.transforms.observation_critic["keys"]:
        name = key if isinstance(key, str) else tuple(key)
        size = learner.env.observation_spec[name][0].shape.numel()
        parts.append(moved[name] if name in moved else torch.zeros(size))
    return torch.cat(parts)


def test_a_training_goes_on_from_it_with_a_normaliser_that_both_networks_share(tmp_path):
    """The critic's weights are read last: they must not bring the old mean back."""
    same = [
        f"env.transforms.{name}.keys=[projected_gravity,joint_position,target]"
        for name in ("observation", "observation_critic")
    ]
    shared = ("critic.normalize=shared", *same)
    learner = learned(*shared)
    _, new = shifted(learner, tmp_path)
    mean = normalizer_of(learner.critic).mean.clone()
    goes_on = Learner(config_of(*shared))
    warm_start(goes_on, new)
    assert normalizer_of(goes_on.critic) is normalizer_of(goes_on.actor)
    assert_close(normalizer_of(goes_on.actor).mean, mean + torch.cat([NONE, ANGLES, ANGLES]))


def test_what_cannot_be_moved_is_refused(tmp_path):
    with pytest.raises(ValueError, match="offsets must name joints of zeroth01, got knee"):
        ShiftedPose(run="twin", offsets={"knee": 0.1})
    with pytest.raises(ValueError, match="actions are joint angles, atalante is not"):
        ShiftedPose(run="atalante", offsets=OFFSETS)


def test_a_symmetric_policy_is_moved_on_both_sides_alone(tmp_path):
    learner = learned("actor.symmetric=true", "critic.symmetric=true")
    with pytest.raises(ValueError, match="offsets must be the same on both sides"):
        shifted(learner, tmp_path)
    both = {"left_knee_pitch": 0.2, "right_knee_pitch": 0.2, "left_hip_roll": 0.1}
    with pytest.raises(ValueError, match="offsets must be the same on both sides"):
        shifted(learner, tmp_path, both | {"right_hip_roll": 0.1})
    shifted(learner, tmp_path, both | {"right_hip_roll": -0.1})
