"""Makes a policy that does around another pose what it did around its own."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Composite

from zfall import checkpoint as checkpoints
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.modules.actors import normalizer_of
from zfall.modules.heads import Head
from zfall.policies.load import checkpoint_or_file, policy_of
from zfall.training.build import build_critic
from zfall.values import Name


class ShiftedPose:
    """A policy whose joint angles are moved: those that it sees, and those that it asks for.

    With ``o`` what it sees and ``a(o)`` what it does, the new policy is ``a(o - d) + d``, ``d``
    being the offsets where ``o`` and ``a`` are angles of joints. Nothing is trained: a normaliser's
    mean and the biases of the means that a head gives change. Where gravity and contacts hardly
    differ in the other pose, as in legs that are a little straighter, it still stands and steps,
    and a training can go on from there. Rewards for a pose move one far more slowly.

    The critic, if there is one, is moved by what it sees of joints in the same way.

    Args:
        run: the policy: a run folder, the name of one that ships, or the file of a checkpoint.
        offsets: by joint [rad]; joints that are not named keep theirs.
        checkpoint: of a run folder.

    Raises:
        ValueError: if there is no such policy or joint, its actions are no joint angles, or it has
            no normaliser or no head whose mean can be moved.
    """

    suffix: ClassVar[str] = ".pt"
    is_policy: ClassVar[bool] = True

    def __init__(self, *, run: Name, offsets: Mapping[str, float], checkpoint: Name = "last"):
        path = checkpoint_or_file(run, checkpoint)
        content = checkpoints.load(path)
        config = OmegaConf.create(content["config"])
        env = instantiate(config.env, base_env={"num_envs": 1}, training=True)
        robot = env.base_env.robot
        for name in offsets:
            if name not in robot.joints:
                raise ValueError(f"offsets must name joints of {robot.name}, got {name}.")
        made = next((t for t in env.transform if isinstance(t, JointPositionTarget)), None)
        if made is None:
            raise ValueError(f"run must be a policy whose actions are joint angles, {run} is not.")
        angles = torch.tensor([offsets.get(name, 0.0) for name in robot.joints])
        moved = {"joint_position": angles, "target": angles, "last_action": angles / made.scale}
        self.content = {key: content[key] for key in ("config", "robot")}
        actor: Any = policy_of(content, config.env, path)
        for name in ("actor", "policy"):
            actor.load_state_dict(content[name])
            _move_seen(actor, config, "observation", env.observation_spec, moved)
            _move_done(actor, moved["last_action"])
            self.content[name] = _weights(actor)
        if "critic" in content:
            critic: Any = build_critic(config, env, actor)
            critic.load_state_dict(content["critic"])
            if normalizer_of(critic) is not normalizer_of(actor):
                _move_seen(critic, config, "observation_critic", env.observation_spec, moved)
            self.content["critic"] = _weights(critic)

    def make(self, path: Path, console: Console) -> None:
        """Writes the checkpoint."""
        checkpoints.save(path, self.content)

    def stand_in(self, path: Path) -> None:
        """Writes the same: it takes no longer."""
        checkpoints.save(path, self.content)


def _move_seen(
    network: TensorDictModuleBase,
    config: DictConfig,
    vector: str,
    spec: Composite,
    moved: Mapping[Any, Tensor],
) -> None:
    """Moves the mean that a network subtracts from a vector that its env puts together."""
    normalizer = normalizer_of(network)
    if normalizer is None:
        raise ValueError("run must be a policy that normalises what it sees, this one does not.")
    parts = []
    for key in config.env.transforms[vector]["keys"]:
        name = key if isinstance(key, str) else tuple(key)
        size = spec[name].shape[1:].numel()
        parts.append(moved.get(name, torch.zeros(size)))
    normalizer.mean.add_(torch.cat(parts))


def _move_done(actor: nn.Module, offset: Tensor) -> None:
    """Moves the mean of the actions."""
    head = next((part for part in actor.modules() if isinstance(part, Head)), None)
    if head is None:
        raise ValueError("run must be a policy with a Gaussian head or one of mixtures.")
    head.move_mean(offset)


def _weights(network: nn.Module) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in network.state_dict().items()}
