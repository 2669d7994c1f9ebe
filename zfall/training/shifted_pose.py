"""Makes a policy that does around another pose what it did around its own."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.console import Console
from torch import Tensor, nn

from zfall import checkpoint as checkpoints
from zfall.envs.mirror import mirror_action
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.modules.actors import normalizer_of
from zfall.modules.heads import Head
from zfall.modules.symmetric import TaskMirror
from zfall.policies.load import checkpoint_or_file, policy_of
from zfall.training.build import build_critic
from zfall.training.task_facts import TaskFacts
from zfall.values import Name


class ShiftedPose:
    """A policy whose joint angles are moved: those that it sees, and those that it asks for.

    With ``o`` what it sees and ``a(o)`` what it does, the new policy is ``a(o - d) + d``, ``d``
    being the offsets where ``o`` and ``a`` are angles of joints. Nothing is trained: a normaliser's
    mean and the biases of the means that a head gives change. Where gravity and contacts hardly
    differ in the other pose, as in legs that are a little straighter, it still stands and steps,
    and a training can go on from there. A reward for a pose changes it far more slowly.

    The critic, if there is one, is changed in the same way. Of what they see, ``joint_position``,
    ``target``, ``last_action`` and the histories of these are moved.

    Args:
        run: the policy: a run folder, the name of one that ships, or the file of a checkpoint.
        offsets: by joint [rad]; joints that are not named keep theirs.
        checkpoint: of a run folder.

    Raises:
        ValueError: if there is no such policy or joint; if its actions are no joint angles, or it
            sees none; if a network has no normaliser, or the policy no head whose mean can be
            moved; if a symmetric policy is to be moved on one side alone.
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
        action = angles / made.scale
        moved = {"joint_position": angles, "target": angles, "last_action": action}
        task = TaskFacts(env, config)
        self.content = {key: content[key] for key in ("config", "robot")}
        actor: Any = policy_of(content, config.env, path)
        mirrored = any(isinstance(part, TaskMirror) for part in actor.modules())
        if mirrored and not torch.allclose(mirror_action(robot, len(action))(action), action):
            raise ValueError(
                f"offsets must be the same on both sides, as {run} is a symmetric policy: those of "
                "right joints the mirror images of those of left ones."
            )
        for name in ("actor", "policy"):
            actor.load_state_dict(content[name])
            _move_seen(actor, "observation", task, moved, f"the policy of {run}")
            _move_done(actor, action)
            self.content[name] = _weights(actor)
        if "critic" in content:
            critic: Any = build_critic(config, env, actor)
            critic.load_state_dict(content["critic"])  # a shared normaliser is as it was, too
            _move_seen(critic, "observation_critic", task, moved, f"the critic of {run}")
            self.content["critic"] = _weights(critic)

    def make(self, path: Path, console: Console) -> None:
        """Writes the checkpoint."""
        checkpoints.save(path, self.content)

    def stand_in(self, path: Path) -> None:
        """Writes the same: it takes no longer."""
        checkpoints.save(path, self.content)


def _move_seen(
    network: nn.Module, key: str, task: TaskFacts, moved: Mapping[str, Tensor], name: str
) -> None:
    """Moves the mean that a network subtracts from what it sees."""
    normalizer = normalizer_of(network)
    if normalizer is None:
        raise ValueError(f"{name} must normalise what it sees, it does not.")
    spans = task.spans(key)
    scaled = [t for t in task.env.transform if key in (t.out_keys or ()) and hasattr(t, "affine")]
    offset, found = torch.zeros_like(normalizer.mean), False
    for quantity, places in spans.items():
        change = moved.get(quantity.removeprefix("history/"))
        if change is not None:
            found = True
            offset[places] = change.repeat(len(offset[places]) // len(change))
    if scaled or not found:
        raise ValueError(f"{name} must see {' or '.join(moved)}, as they are, in one vector.")
    normalizer.mean.add_(offset)


def _move_done(actor: nn.Module, offset: Tensor) -> None:
    """Moves the mean of the actions."""
    head = next((part for part in actor.modules() if isinstance(part, Head)), None)
    if head is None:
        raise ValueError("run must be a policy with a Gaussian head or one of mixtures.")
    head.move_mean(offset)


def _weights(network: nn.Module) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in network.state_dict().items()}
