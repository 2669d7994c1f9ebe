"""Env, actor, critic and optimizer of one run, and what an update does with them."""

import inspect
from typing import Any

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential
from torch.nn.utils import clip_grad_norm_
from torch.optim.swa_utils import AveragedModel
from torchrl.envs import TransformedEnv
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.value import GAE

from zfall.losses.advantage import RecurrentGAE, advantage_among_alike
from zfall.losses.burn_in import burnt_in
from zfall.losses.ppo import PenalizedPPOLoss
from zfall.modules.actors import normalizer_of, recurrent_keys
from zfall.modules.exploring import ExploringActor
from zfall.simulation.model import identity_of
from zfall.training.auxiliary import buffers_of, build, check_parameters, check_reads, check_writes
from zfall.training.averaging import moving_average
from zfall.training.checks import check_finite, check_ranges, check_task
from zfall.training.collection import Worlds
from zfall.training.objective import ppo_loss


class Learner:
    """Collects batches and learns from them; ``state_dict`` holds all that the next one needs.

    ``policy`` is what comes out: the actor with its weights averaged over the last updates
    (``moving_average``), which takes the ups and downs of single updates out of it.

    Args:
        cfg: the composed config, see ``recipes/train.yaml``.
    """

    def __init__(self, cfg: DictConfig):
        check_ranges(cfg)
        torch.manual_seed(cfg.seed)
        self.cfg = cfg
        self.worlds = Worlds(cfg.env, cfg.num_envs, cfg.groups)
        check_task(self.env, cfg.alike)
        spec, action_spec = self.env.observation_spec, self.env.action_spec
        self.actor = instantiate(cfg.actor, spec, action_spec)
        self._average = AveragedModel(self.actor, multi_avg_fn=moving_average(cfg.averaging))
        shared: dict[str, Any] = {}
        if cfg.critic.get("normalize") == "shared":
            shared["normalize"] = normalizer_of(self.actor)
            if shared["normalize"] is None:
                raise ValueError("critic.normalize=shared needs an actor that has a normaliser.")
        self.critic = instantiate(cfg.critic, spec, **shared)
        self._teachers: dict[str, str] = {}  # digests of the policies that losses learn from
        self.auxiliary = [
            self._build(loss, self.actor, place=f"auxiliary_losses.{name}")
            for name, loss in cfg.auxiliary_losses.items()
        ]
        self.augmentation = None
        if cfg.augmentation:
            self.augmentation = self._build(
                cfg.augmentation, [self.actor, self.critic], place="augmentation"
            )
        for name, loss in zip(cfg.auxiliary_losses, self.auxiliary, strict=True):
            key = getattr(loss, "neighbour_key", None)
            if self.augmentation is not None and key not in (None, "observation_neighbour"):
                raise ValueError(
                    f"auxiliary_losses.{name}.neighbour_key must be observation_neighbour for the "
                    f"augmentation to mirror it, got {key}."
                )
        # What has a memory runs along with the actor.
        beside = [self.critic] if recurrent_keys(self.critic) else []
        followed = [*self.auxiliary, self.augmentation]
        memories = (m for module in followed for m in getattr(module, "memories", ()))
        beside += {memory.key: memory for memory in memories}.values()
        self._remembering = list({id(m): m for m in (self.actor, self.critic, *beside)}.values())
        hidden = [key for module in (self.actor, *beside) for key in recurrent_keys(module)]
        for module in (self.actor, *beside):
            if recurrent_keys(module):
                self.worlds.remember(module)
        if cfg.burn_in and not hidden:
            raise ValueError(f"burn_in must be 0 without memory to refresh, got {cfg.burn_in}.")
        acting: Any = self.actor
        if "exploration_noise" in spec.keys():
            acting = ExploringActor(self.actor)
        self._acting = TensorDictSequential(acting, *beside) if beside else acting
        loss = cfg.loss
        self.advantage: GAE
        if recurrent_keys(self.critic):
            self.advantage = RecurrentGAE(self.critic, gamma=loss.gamma, lmbda=loss.lmbda)
        else:
            self.advantage = GAE(
                gamma=loss.gamma, lmbda=loss.lmbda, value_network=self.critic, deactivate_vmap=True
            )
        self.loss = ppo_loss(loss, self.actor, self.critic)
        # These want to know what the policy does elsewhere, too: PPO's loss finds out, one's own
        # may not, and a mode is searched for by those who need it.
        statistic = self.actor[-1].distribution_kwargs.get("statistic", "mean")
        self._answers = type(self.loss) is PenalizedPPOLoss and statistic == "mean"
        self.parameters = [*self.actor.parameters(), *self.critic.parameters()]
        reading: dict[str, Any] = {
            f"auxiliary_losses.{name}": loss
            for name, loss in zip(cfg.auxiliary_losses, self.auxiliary, strict=True)
        }
        for place, module in {"loss": self.loss, **reading}.items():
            check_parameters(module, place, self.parameters)
        check_writes({"loss": self.loss, **reading})
        kind, optimizer = instantiate(cfg.optimizer, _partial_=True).func, dict(cfg.optimizer)
        known = inspect.signature(kind).parameters.values()
        if not any(value.name == "fused" or value.kind is value.VAR_KEYWORD for value in known):
            optimizer.pop("fused", None)  # Adam's, from train.yaml: another has taken its place
        self.optimizer = instantiate(optimizer, self.parameters)
        self.scheduler = instantiate(cfg.scheduler, self.optimizer) if cfg.scheduler else None
        if self.scheduler and not (
            "kl" in inspect.signature(self.scheduler.step).parameters
            and hasattr(self.scheduler, "load_state_dict")
        ):
            raise ValueError(
                "scheduler must follow the KL divergence, torchrl.objectives.KLAdaptiveLR or one "
                "with step(kl), state_dict and load_state_dict, or be null; "
                f"got {cfg.scheduler._target_}."
            )
        inputs = ["observation", "observation_critic", "is_init", *hidden]
        self._learned = [*inputs, "action", "action_log_prob"]
        if type(self.loss) is not PenalizedPPOLoss:  # what that reads is there
            reading["loss"] = self.loss
        wanted = [key for loss in reading.values() for key in loss.in_keys]
        self._learned += [key for key in dict.fromkeys(wanted) if key not in self._learned]
        flags = ["reward", "done", "terminated", "truncated", "reward_terms", "terminations"]
        flags += ["episode_reward", "step_count", "diverged"]
        after = [("next", key) for key in [*self.critic.in_keys, *flags]]
        self._stored = [*self._learned, "state_value", *after]
        self._recurrent = bool(hidden)
        samples = cfg.num_envs * (1 if hidden else cfg.rollout_steps)
        if cfg.minibatches > samples:
            kind = "sequences" if hidden else "samples"
            raise ValueError(
                f"minibatches must not be more than the {samples} {kind} of an update, "
                f"got {cfg.minibatches}."
            )
        self.worlds.begin(cfg.seed)
        given = {*self.carrier.keys(True, True), *self._acting.out_keys, *self.env.reward_keys}
        given |= {"state_value", "advantage", "value_target"}
        check_reads(reading, given)
        self.frames = self.updates = 0

    def _build(self, config: DictConfig, *args: object, place: str) -> Any:
        """A loss or augmentation; what its teacher was is kept."""
        module, teacher = build(config, place, self.env, self.cfg, *args)
        if teacher is not None:
            self._teachers[place] = teacher
        return module

    @property
    def policy(self) -> torch.nn.Module:
        """The actor with averaged weights."""
        return self._average.module

    @property
    def env(self) -> TransformedEnv:
        """The env, or the first of them if the worlds are in groups."""
        return self.worlds.env

    @property
    def carrier(self) -> TensorDictBase:
        """What all worlds are in ``(N,)``, before the coming step."""
        return self.worlds.carrier

    @property
    def frames_per_batch(self) -> int:
        """Control steps of one update, over all worlds."""
        return int(self.cfg.num_envs * self.cfg.rollout_steps)

    def collect(self) -> TensorDictBase:
        """Runs the policy for ``rollout_steps``; returns the batch ``(N, T)``."""
        self.frames += self.frames_per_batch
        return self.worlds.run(self._act, self.cfg.rollout_steps, self._stored)

    def _act(self, carrier: TensorDictBase) -> TensorDictBase:
        # Of the carrier's dozens of keys TensorDict would copy and write back all.
        acted = self._acting(carrier.select(*self._acting.in_keys))
        return carrier.update(acted.select(*self._acting.out_keys))

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Some passes of PPO over the batch; returns the means of the last pass."""
        cfg = self.cfg
        with torch.no_grad(), set_recurrent_mode(True):
            self.advantage(batch)
        if cfg.alike > 1:
            batch["advantage"] = advantage_among_alike(batch["advantage"], cfg.alike)
        if cfg.loss.normalize_advantage == "batch":
            advantage = batch["advantage"]
            batch["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp_min(1e-6)
        data = batch.select(*self._learned, "advantage", "value_target", "state_value")
        if not self._recurrent:
            data = data.reshape(-1)  # else a minibatch holds whole sequences
        passes = 0
        for _ in range(cfg.epochs):
            passes, outputs, drawn = passes + 1, [], []
            for rows in torch.randperm(len(data)).tensor_split(cfg.minibatches):
                part = _rows(data, rows)
                if self.augmentation is not None:
                    part = self.augmentation(part)
                if cfg.burn_in:
                    part = burnt_in(part, self._remembering, cfg.burn_in)
                out, some, actions = self._ppo(part)
                for auxiliary in self.auxiliary:
                    seen = some
                    if auxiliary in actions:
                        seen = some.copy().set(auxiliary.companion_key, actions[auxiliary])
                    written = auxiliary(seen)
                    if not any(key.startswith("loss_") for key in written.keys()):
                        raise ValueError(
                            f"{type(auxiliary).__name__} must write a loss under a name that "
                            f"begins with loss_, wrote {', '.join(written.keys()) or 'nothing'}."
                        )
                    out.update(written)
                total = sum(value for key, value in out.items() if key.startswith("loss_"))
                total.backward()
                norm = clip_grad_norm_(self.parameters, cfg.max_grad_norm)
                outputs.append({key: value.detach().mean() for key, value in out.items()})
                check_finite(outputs[-1] | {"loss gradient": norm}, self.updates + 1)
                self.optimizer.step()
                self.optimizer.zero_grad()
                drawn.append(part.numel() - int(part.get("mirrored", torch.zeros(1)).sum()))
            shares = torch.tensor(drawn) / sum(drawn) if any(drawn) else torch.zeros(len(drawn))
            divergence = float(shares @ torch.stack([out["kl"] for out in outputs]))
            if cfg.loss.kl_stop is not None and divergence > cfg.loss.kl_stop:
                break
        means = {k: torch.stack([out[k] for out in outputs]).mean().item() for k in outputs[0]}
        del means["kl_approx"]  # the same with more noise, TorchRL's
        means |= {"kl": divergence, "passes": passes}
        if any(drawn) and cfg.epochs * cfg.minibatches > 1:  # before the only step it is 0
            if self.scheduler is not None:
                self.scheduler.step(max(divergence, 1e-6))  # 0 would leave it where nothing moves
            self.loss.adapt(divergence)
        of_actor, of_critic = normalizer_of(self.actor), normalizer_of(self.critic)
        if of_actor is not None:
            of_actor.update(batch["observation"])
        if of_critic is not None and of_critic is not of_actor:
            of_critic.update(batch["observation_critic"])
        self._average.update_parameters(self.actor)
        self.updates += 1
        return means

    def _ppo(
        self, part: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase, dict[torch.nn.Module, torch.Tensor]]:
        """PPO's losses of a minibatch, what those beside see of it, what some of them asked for."""
        loss = self.loss
        rows = max(1, round(self.cfg.auxiliary_share * len(part)))
        some = part[:rows]  # the order is random
        asking = [x for x in self.auxiliary if self._answers and hasattr(x, "companions")]
        asked = {x: x.companions(some) for x in asking}
        asking = [x for x in asking if asked[x] is not None]
        asking.sort(key=lambda x: "memory_of" in asked[x].keys())  # these have to come last
        loss.beside = [asked[x] for x in asking]
        out = loss(part)
        distribution, loss.distribution = loss.distribution, None
        elsewhere, loss.distribution_beside = loss.distribution_beside, None
        if self.auxiliary and getattr(distribution, "statistic", "mean") == "mean":
            # A mode is searched for: those who need it do so for their share alone.
            some["deterministic_action"] = distribution.deterministic_sample[:rows]
        if not asking:
            return out, some, {}
        actions = elsewhere.deterministic_sample.split(rows)
        return out, some, dict(zip(asking, actions, strict=True))

    def _buffers(self) -> dict[str, torch.Tensor]:
        modules = {"loss": self.loss, "augmentation": self.augmentation}
        modules |= dict(zip(self.cfg.auxiliary_losses, self.auxiliary, strict=True))
        return buffers_of(modules, (self.actor, self.critic))

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "config": OmegaConf.to_yaml(self.cfg, resolve=True),
            "robot": identity_of(self.env.base_env.robot),
            "actor": self.actor.state_dict(),
            "policy": self.policy.state_dict(),
            "averaged": int(self._average.n_averaged),
            "critic": self.critic.state_dict(),
            "teachers": self._teachers,
            "optimizer": self.optimizer.state_dict(),
            "scheduler": self.scheduler.state_dict() if self.scheduler else {},
            "buffers": {key: value.clone() for key, value in self._buffers().items()},
            "worlds": self.worlds.state_dict(),
            "rng": torch.get_rng_state(),
            "frames": self.frames,
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from what ``state_dict`` gave.

        Raises:
            ValueError: if a policy that it learns from has changed since.
        """
        for place, known in state.get("teachers", {}).items():
            if self._teachers.get(place) != known:
                raise ValueError(
                    f"{place}.teacher must be what it was when the run began, its weights have "
                    "changed: put them back, or begin anew."
                )
        self.worlds.load_state_dict(state["worlds"])  # first, as it may refuse
        self.actor.load_state_dict(state["actor"])
        self.policy.load_state_dict(state["policy"])
        self._average.n_averaged.fill_(state["averaged"])
        self.critic.load_state_dict(state["critic"])
        self.optimizer.load_state_dict(state["optimizer"])
        if self.scheduler:
            self.scheduler.load_state_dict(state["scheduler"])
        for key, value in self._buffers().items():
            value.copy_(state["buffers"][key])
        torch.set_rng_state(state["rng"])
        self.frames, self.updates = state["frames"], state["updates"]


def _rows(data: TensorDictBase, rows: torch.Tensor) -> TensorDictBase:
    """``data[rows]``, whole rows at once in place of number by number: a third of the time."""
    shape = [len(rows), *data.shape[1:]]
    part = data.apply(lambda value: value.index_select(0, rows), batch_size=shape)
    assert part is not None
    return part
