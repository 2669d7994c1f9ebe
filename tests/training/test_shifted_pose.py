"""A policy that does around another pose what it did around its own."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall import checkpoint
from zfall.configs import compose_config
from zfall.policies import load_policy
from zfall.robots import ZEROTH01
from zfall.training.build import build_critic
from zfall.training.learner import Learner
from zfall.training.shifted_pose import ShiftedPose

SCALE = 0.6  # of an action [rad]
KEYS = "projected_gravity,joint_position,joint_velocity,target,last_action"
OFFSETS = {"left_knee_pitch": 0.4, "right_elbow_roll": -0.1}  # [rad]


def learned(actor: str):
    """A learner whose networks are random, as if it had learned something."""
    small = ["num_envs=2", "rollout_steps=2", "minibatches=1", f"actor={actor}"]
    seen = [f"env.transforms.observation.keys=[{KEYS}]"]
    last = (
        "+env.transforms.last={_target_: zfall.envs.transforms.windows.LastAction, before: noise}"
    )
    learner = Learner(compose_config([*small, *seen, last]))
    torch.manual_seed(0)
    for network in (learner.actor, learner.policy, learner.critic):
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.2)
        for name, buffer in network.named_buffers():
            if name.endswith(("mean", "variance")):
                torch.nn.init.uniform_(buffer, 0.5, 1.0)
    return learner


@pytest.mark.parametrize("actor", ["mlp_gaussian", "gru_mog", "gru_shared_mog"])
def test_it_acts_and_judges_in_the_new_pose_as_it_did_in_the_old(actor, tmp_path):
    """``a'(o + d) = a(o) + d``, by joint; the memory goes the same way, and the critic's value."""
    learner = learned(actor)
    old, new = tmp_path / "old.pt", tmp_path / "new.pt"
    checkpoint.save(old, learner.state_dict())
    ShiftedPose(run=str(old), offsets=OFFSETS).make(new, console=None)

    angles = torch.zeros(20)
    for name, value in OFFSETS.items():
        angles[ZEROTH01.joints.index(name)] = value
    nothing, velocities = torch.zeros(3), torch.zeros(20)
    moved = torch.cat([nothing, angles, velocities, angles, angles / SCALE])

    torch.manual_seed(1)
    before, after = load_policy(old), load_policy(new)
    env = before.env(3)
    td, seen = env.reset(), torch.randn(3, len(moved))
    for _ in range(2):  # the second time with a memory
        one = before.actor(td.clone().set("observation", seen))
        other = after.actor(td.clone().set("observation", seen + moved))
        assert_close(other["action"], one["action"] + angles / SCALE)
        for key in before.actor.out_keys:
            if isinstance(key, tuple):
                assert_close(other[key], one[key])
                td[key[1]] = one[key]

    critic = build_critic(learner.cfg, learner.env, after.actor)
    critic.load_state_dict(checkpoint.load(new)["critic"])
    spec = learner.env.observation_spec["observation_critic"]
    judged = TensorDict({"observation_critic": torch.randn(2, spec.shape[-1])}, [2])
    value = learner.critic(judged.clone())["state_value"]
    judged["observation_critic"] += _moved_critic(learner, angles)
    assert_close(critic(judged)["state_value"], value)


def _moved_critic(learner, angles):
    """What the critic sees of joint angles, moved: found by the names of what it is shown."""
    parts, moved = [], {"joint_position": angles, "target": angles, "last_action": angles / SCALE}
    for key in learner.cfg.env.transforms.observation_critic["keys"]:
        name = key if isinstance(key, str) else tuple(key)
        size = learner.env.observation_spec[name][0].shape.numel()
        parts.append(moved[name] if name in moved else torch.zeros(size))
    return torch.cat(parts)


def test_another_joint_is_refused():
    with pytest.raises(ValueError, match="offsets must name joints of zeroth01, got knee"):
        ShiftedPose(run="twin", offsets={"knee": 0.1})
