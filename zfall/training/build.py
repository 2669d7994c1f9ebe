"""Everything that one training is made of, built from its config before it begins."""

from dataclasses import dataclass, replace
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig
from tensordict import NestedKey, unravel_key
from tensordict.nn import TensorDictSequential
from torchrl.data import Composite
from torchrl.envs import TransformedEnv
from torchrl.objectives.value import GAE

from zfall.errors import named
from zfall.losses.advantage import RecurrentGAE
from zfall.losses.ppo import PenalizedPPOLoss
from zfall.modules.actors import normalizer_of, recurrent_keys
from zfall.modules.exploring import ExploringActor
from zfall.training.losses import build_loss, check_losses, ppo_loss
from zfall.training.task_facts import TaskFacts


@dataclass
class Losses:
    """What a minibatch is learned from.

    Attributes:
        ppo: PPO's loss.
        auxiliary: the losses added to it, by their place in the config.
        augmentation: what is done to a minibatch before; ``None``: nothing.
        teachers: digests of the policies that losses learn from, by place.
    """

    ppo: PenalizedPPOLoss
    auxiliary: dict[str, Any]
    augmentation: Any
    teachers: dict[str, str]

    @property
    def by_place(self) -> dict[str, Any]:
        """All losses by their place in the config."""
        return {"loss": self.ppo, **self.auxiliary}


def build_actor(cfg: DictConfig, env: TransformedEnv) -> Any:
    """The policy."""
    actor = instantiate(cfg.actor, env.observation_spec, env.action_spec)
    return _told(actor, TaskFacts(env, cfg, "actor"))


def _told(network: Any, task: TaskFacts) -> Any:
    """The network, whose parts with a ``for_task`` know the task."""
    for part in network.modules():
        if hasattr(part, "for_task"):
            part.for_task(task)
    return network


def build_critic(cfg: DictConfig, env: TransformedEnv, actor: Any) -> Any:
    """The critic; with ``normalize: shared`` it has the actor's normaliser.

    Raises:
        ValueError: if the actor has none to share.
    """
    shared: dict[str, Any] = {}
    if cfg.critic.get("normalize") == "shared":
        shared["normalize"] = normalizer_of(actor)
        if shared["normalize"] is None:
            raise ValueError("critic.normalize=shared needs an actor that has a normaliser.")
    critic = instantiate(cfg.critic, env.observation_spec, **shared)
    return _told(critic, TaskFacts(env, cfg, "critic"))


def build_losses(cfg: DictConfig, env: TransformedEnv, actor: Any, critic: Any) -> Losses:
    """All losses of a training, checked against each other.

    Raises:
        ValueError: on a loss that cannot be built, trains nothing, or writes another's name.
    """
    task = TaskFacts(env, cfg)
    auxiliary = {}
    for name, config in cfg.auxiliary_losses.items():
        if config is None:
            continue
        if name in ("loss", "augmentation"):  # whose names they have in a checkpoint
            raise ValueError(f"auxiliary_losses.{name} must have another name, {name} is taken.")
        place = f"auxiliary_losses.{name}"
        auxiliary[place] = build_loss(config, place, actor, task)
    augmentation = None
    if cfg.augmentation:
        memory = [key for network in (actor, critic) for key in recurrent_keys(network)]
        read: dict[NestedKey, None] = {}  # by losses: mirrored like what the networks see
        for place, loss in auxiliary.items():
            seen = [key for key in observed_by(loss, env) if key not in memory]
            with named(place):
                for key in seen:
                    task.mirror(key)
            read |= dict.fromkeys(seen)
        task = replace(task, read_by_losses=tuple(read))
        augmentation = build_loss(cfg.augmentation, "augmentation", [actor, critic], task)
        for place, loss in auxiliary.items():
            key = getattr(loss, "neighbour_key", None)
            if key not in (None, "observation_neighbour"):
                raise ValueError(
                    f"{place}.neighbour_key must be observation_neighbour for the augmentation to "
                    f"mirror it, got {key}."
                )
    losses = Losses(ppo_loss(cfg.loss, actor, critic), auxiliary, augmentation, task.teachers)
    check_losses(losses.by_place, [*actor.parameters(), *critic.parameters()])
    return losses


def observed_by(loss: Any, env: TransformedEnv) -> list[NestedKey]:
    """What a loss reads of the world, of a step or of the next; not its ``invariant_keys``.

    Nor its ``neighbour_key``: the augmentation mirrors neighbours like what they are neighbours of.
    """
    there = env.observation_spec.keys(True, True)
    here = [
        unravel_key(key[1:]) if isinstance(key, tuple) and key[0] == "next" else key
        for key in getattr(loss, "in_keys", ())  # ``check_losses`` misses them
    ]
    neighbour = getattr(loss, "neighbour_key", None)
    same = ("is_init", neighbour, *getattr(loss, "invariant_keys", ()))
    return [key for key in dict.fromkeys(here) if key in there and key not in same]


def followers(critic: Any, losses: Losses) -> list[Any]:
    """Networks with a memory, besides the actor's, that run along with it in every step."""
    along = [critic] if recurrent_keys(critic) else []
    asking = [*losses.auxiliary.values(), losses.augmentation]
    memories = [memory for loss in asking for memory in getattr(loss, "memories", ())]
    return along + list({tuple(memory.keys.items()): memory for memory in memories}.values())


def acting_policy(actor: Any, along: list[Any], spec: Composite) -> Any:
    """What acts in every step: the actor, which explores, and the networks that run along."""
    acting = ExploringActor(actor) if "exploration_noise" in spec.keys() else actor
    return TensorDictSequential(acting, *along) if along else acting


def build_advantage(cfg: DictConfig, critic: Any) -> GAE:
    """The estimator of advantages that fits the critic."""
    values = {"gamma": cfg.loss.gamma, "lmbda": cfg.loss.lmbda}
    if recurrent_keys(critic):
        return RecurrentGAE(critic, **values)
    return GAE(**values, value_network=critic, deactivate_vmap=True)


def learned_keys(losses: Losses, hidden: list[str]) -> list[NestedKey]:
    """Keys of a batch that its minibatches need."""
    keys: list[NestedKey] = ["is_init", *hidden, "action", "action_log_prob"]
    wanted = [key for loss in losses.by_place.values() for key in loss.in_keys]
    made = ("advantage", "value_target", "state_value")  # after the batch is collected
    return list(dict.fromkeys([*keys, *(key for key in wanted if key not in made)]))


def stored_keys(learned: list[NestedKey], critic: Any) -> list[NestedKey]:
    """Keys to keep while a batch is collected: those learned from, and those looked at.

    Args:
        learned: by minibatches and by normalisers.
        critic: which also sees what follows a step.
    """
    flags = ["reward", "done", "terminated", "truncated", "reward_terms", "terminations"]
    flags += ["episode_reward", "step_count", "diverged"]
    after: list[NestedKey] = [("next", key) for key in [*critic.in_keys, *flags]]
    return list(dict.fromkeys([*learned, "state_value", *after]))
