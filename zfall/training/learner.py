"""One training: collects batches and learns from them."""

from collections.abc import Mapping
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torchrl.envs import TransformedEnv
from torchrl.modules import set_recurrent_mode

from zfall.losses.advantage import advantage_among_alike
from zfall.losses.burn_in import burnt_in
from zfall.losses.policy_pass import keep_policy, policy_pass
from zfall.losses.ppo import PenalizedPPOLoss
from zfall.modules.actors import normalizers_of, recurrent_keys
from zfall.training import build
from zfall.training.averaging import moving_average
from zfall.training.checks import check_finite, check_task, whole_config
from zfall.training.collection import Worlds
from zfall.training.gradients import clip_gradients, parts_of
from zfall.training.losses import buffers_of, check_networks, check_reads
from zfall.training.minibatches import (
    divergence_of,
    losses_of,
    means_of,
    rows_of,
)
from zfall.training.optimizers import build_optimizer, follow
from zfall.training.ranks import ALONE, Ranks, Share
from zfall.training.state import restore, state_of
from zfall.training.transfers import Transfers


class Learner:
    """Collects batches and learns from them; ``state_dict`` holds all that the next one needs.

    ``policy`` is what comes out: the actor with its weights averaged over the last updates
    (``moving_average``), which takes the ups and downs of single updates out of it.

    Args:
        config: as ``recipes/train.yaml`` composes it, or a nested dict of the same keys; those of
            its top level that are missing are the quickstart's.
        ranks: the processes that share the training.

    Raises:
        ValueError: on a value that no training can have, naming its key.
    """

    def __init__(self, config: DictConfig | Mapping[str, Any], ranks: Ranks = ALONE):
        self.cfg = cfg = whole_config(config)
        self.ranks, self.transfers = ranks, Transfers(cfg.device)
        if cfg.get("stages"):
            raise ValueError(
                "stages must be {} for a Learner, which is one stage: "
                "zfall.training.stages.stages_of gives them, recipes.train trains them."
            )
        torch.manual_seed(cfg.seed)
        self.worlds = Worlds(cfg.env, cfg.num_envs, cfg.groups, ranks, cfg.alike)
        check_task(self.env, cfg)
        spec = self.env.observation_spec
        self.actor = build.build_actor(cfg, self.env)
        self.transfers.place([self.actor])
        self.average = AveragedModel(self.actor, multi_avg_fn=moving_average(cfg.averaging))
        self.critic = build.build_critic(cfg, self.env, self.actor)
        self.transfers.place([self.critic])
        self.losses = build.build_losses(cfg, self.env, self.actor, self.critic)
        self.transfers.place([*self.losses.by_place.values(), self.losses.augmentation])
        ranks.take_over(self.losses.by_place)
        along = build.followers(self.critic, self.losses)
        self._remembering = [m for m in (self.actor, *along) if recurrent_keys(m)]
        hidden = [key for module in self._remembering for key in recurrent_keys(module)]
        for module in self._remembering:
            self.worlds.remember(module, "critic" if module is self.critic else "actor")
        if cfg.burn_in and not hidden:
            raise ValueError(f"burn_in must be 0 without memory to refresh, got {cfg.burn_in}.")
        self._acting = build.acting_policy(self.actor, along, spec)
        self.advantage = build.build_advantage(cfg, self.critic)
        self._parts = parts_of(self.actor, self.critic)
        self.parameters = [each for part in self._parts.values() for each in part]
        self.optimizer, self.scheduler = build_optimizer(cfg, self.parameters)
        # A mode is searched for, by the losses that need it and for their share alone.
        self._one_pass = self.actor[-1].distribution_kwargs.get("statistic", "mean") == "mean"
        # One that both share sees what the actor does.
        self._normalizers = normalizers_of(self.critic, spec) | normalizers_of(self.actor, spec)
        self._learned = build.learned_keys(self.losses, hidden)
        stored = [*self._learned, *self._normalizers.values()]
        self._stored = build.stored_keys(stored, self.critic)
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
        check_networks({"actor": self.actor, "critic": self.critic}, given)
        check_reads(self.losses.by_place, given | {"state_value", "advantage", "value_target"})
        self.frames = self.updates = 0
        self.beginning: dict[str, Tensor] = {}
        self.begins_here()

    def begins_here(self) -> None:
        """Takes the policy at hand for that which training begins with, ``beginning``."""
        weights = self.policy.state_dict()
        self.beginning = {key: value.cpu().clone() for key, value in weights.items()}

    @property
    def policy(self) -> torch.nn.Module:
        """The actor with averaged weights."""
        return self.average.module

    @property
    def env(self) -> TransformedEnv:
        """The env, or the first of them if the worlds are in groups."""
        return self.worlds.env

    @property
    def carrier(self) -> TensorDictBase:
        """What this rank's worlds are in ``(N,)``, before the coming step."""
        return self.worlds.carrier

    @property
    def frames_per_batch(self) -> int:
        """Control steps of one update, over all worlds."""
        return int(self.cfg.num_envs * self.cfg.rollout_steps)

    def collect(self) -> TensorDictBase:
        """Runs the policy for ``rollout_steps``; returns the batch ``(N, T)``.

        Before the first there are ``statistics_batches`` more, which are not learned from: they
        set the statistics by which observations are normalised.
        """
        more = self.cfg.statistics_batches if self.updates == 0 else 0
        for number in range(more + 1):
            self.frames += self.frames_per_batch
            batch = self.worlds.run(self._act, self.cfg.rollout_steps, self._stored)
            if number < more:
                self._see(self.transfers.batch_there(batch))
        return batch

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Some passes of PPO over the batch; returns the means of the last pass."""
        batch = self.transfers.batch_there(batch)
        data = self._with_advantages(batch)
        passes, device = 0, self.transfers.device
        while passes < self.cfg.epochs:
            passes, outputs = passes + 1, []
            shares = self.ranks.minibatches(len(data), self.cfg.minibatches)
            minibatches = [self._augmented(rows_of(data, s.rows.to(device)), s) for s in shares]
            drawn = self.ranks.standardize(minibatches, self.losses.ppo, self.cfg.burn_in)
            for part, share in minibatches:
                if self.cfg.burn_in:
                    part = burnt_in(part, self._remembering, self.cfg.burn_in)
                outputs.append(self._step(self._losses_of(part, share)))
            divergence = divergence_of(outputs, drawn)
            if self.cfg.loss.kl_stop is not None and divergence > self.cfg.loss.kl_stop:
                break
        known = any(drawn) and self.cfg.epochs * self.cfg.minibatches > 1  # 0 before the only step
        self._adapt(batch, divergence if known else None)
        self._see(batch)
        self.average.update_parameters(self.actor)
        self.updates += 1
        return means_of(outputs) | {"kl": divergence, "passes": passes}

    @property
    def loss(self) -> PenalizedPPOLoss:
        """PPO's loss."""
        return self.losses.ppo

    def _act(self, carrier: TensorDictBase) -> TensorDictBase:
        # Of the carrier's dozens of keys TensorDict would copy and write back all.
        acted = self._acting(self.transfers.there(carrier.select(*self._acting.in_keys)))
        return carrier.update(self.transfers.back(acted.select(*self._acting.out_keys)))

    def _with_advantages(self, batch: TensorDictBase) -> TensorDictBase:
        """What is learned from: samples, or whole sequences where something has a memory."""
        with torch.no_grad(), set_recurrent_mode(True):
            self.advantage(batch)
        if self.cfg.alike > 1:
            batch["advantage"] = advantage_among_alike(batch["advantage"], self.cfg.alike)
        if self.cfg.loss.normalize_advantage == "batch":  # else PPO's loss does it, or nobody
            batch["advantage"] = self.ranks.standardized(batch["advantage"])
        data = batch.select(*self._learned, "advantage", "value_target", "state_value")
        return data if self._recurrent else data.reshape(-1)

    def _augmented(self, part: TensorDictBase, share: Share) -> tuple[TensorDictBase, Share]:
        if self.losses.augmentation is None:
            return part, share
        with share.drawing():
            part = self.losses.augmentation(part)
        return part, share.fitted(len(part))

    def _losses_of(self, part: TensorDictBase, share: Share) -> TensorDictBase:
        """All losses of a minibatch, PPO's first, and the figures that they report.

        The actor runs once over the minibatch, and over the states that auxiliary losses add to
        it as ``companions``; these see a share of its rows, whose order is random.
        """
        ppo, auxiliary = self.losses.ppo, self.losses.auxiliary.values()
        if not auxiliary:
            with share.drawing():
                return share.weighed(ppo(part), ppo, part)
        leading = share.leading(self.cfg.auxiliary_share)
        some = part[: len(leading.rows)]
        wanted = {}
        for loss in auxiliary if self._one_pass else ():
            with leading.drawing():
                companions = loss.companions(some) if hasattr(loss, "companions") else None
            if companions is not None:
                wanted[loss] = companions
        with share.drawing():
            policy, actions = policy_pass(self.actor, part, list(wanted.values()))
            out = share.weighed(ppo(keep_policy(part, policy)), ppo, part)
        if self._one_pass:
            some["deterministic_action"] = policy.deterministic_sample[: len(some)]
        there = dict(zip(wanted, actions, strict=True))
        for loss in auxiliary:
            seen = some.copy()  # what one of them writes is none of the others' business
            if loss in there:
                seen[loss.companion_key] = there[loss]
            with leading.drawing():
                out.update(leading.weighed(losses_of(loss, seen), loss, seen))
        return out

    def _step(self, out: TensorDictBase) -> dict[str, Tensor]:
        """One step of the optimizer; returns the figures of the minibatch."""
        total = sum(value for key, value in out.items() if key.startswith("loss_"))
        total.backward()
        figures = self.ranks.add_up(self.parameters, out)
        figures |= clip_gradients(self._parts, self.cfg.max_grad_norm)
        figures = self.transfers.figures_back(figures)
        check_finite(figures, self.updates + 1)
        self.optimizer.step()
        self.optimizer.zero_grad()
        return figures

    def _adapt(self, batch: TensorDictBase, divergence: float | None) -> None:
        """Learning rate and weight of the penalty follow an update, if its divergence is known."""
        if divergence is not None:
            self.losses.ppo.adapt(divergence)
        reward = self.ranks.mean(batch["next", "reward"])
        follow(self.scheduler, reward.item(), divergence)

    def _see(self, batch: TensorDictBase) -> None:
        """Takes the batch into the statistics of the observations, once it is learned from."""
        for normalizer, key in self._normalizers.items():
            normalizer.update(batch[key], self.ranks.moments)

    def buffers(self) -> dict[str, Tensor]:
        """What losses and the augmentation remember, by place."""
        modules = {"loss": self.losses.ppo, "augmentation": self.losses.augmentation}
        for place, loss in self.losses.auxiliary.items():
            modules[place.removeprefix("auxiliary_losses.")] = loss
        return buffers_of(modules, (self.actor, self.critic))

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return state_of(self)

    def load_state_dict(self, state: dict[str, Any]) -> list[str]:
        """Goes on from what ``state_dict`` gave.

        Returns:
            What does not go on, in lines to show.

        Raises:
            ValueError: if a policy that it learns from has changed since.
        """
        return restore(self, state)
