"""Pushed trials from which a trigger is learned."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch import Tensor

from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.observations.measured import read_measured
from zfall.evaluation.baselines import passive
from zfall.evaluation.definitions import load_battery
from zfall.falling.pushed import PUSH_TIME, SPREAD, pushed_worlds, world_of
from zfall.rotations import tilt
from zfall.terminal import QUIET


class History(NamedTuple):
    """K trials at T control steps after the reset.

    Attributes:
        measured: what the network sees ``(K, T, D)``.
        lean: tilt of the trunk ``(K, T)`` [rad].
        rate: angular velocity of the trunk, its norm ``(K, T)`` [rad/s].
        live: whether nothing but the feet has touched the floor yet ``(K, T)`` bool.
        fell: whether the trial ends on the floor ``(K,)`` bool.
        pushed: whether the push has begun ``(K, T)`` bool.
    """

    measured: Tensor
    lean: Tensor
    rate: Tensor
    live: Tensor
    fell: Tensor
    pushed: Tensor


def without_trigger(env_cfg: DictConfig) -> DictConfig:
    """The env's config, in which a policy with modes recovers all the time.

    Its kneels would count as falls, and the network would learn to give up when it does.
    """
    if OmegaConf.select(env_cfg, "transforms.mode") is None:
        return env_cfg
    new = passive(env_cfg.copy())
    OmegaConf.update(new, "transforms.mode.hold", 1000.0, force_add=True)
    OmegaConf.update(new, "transforms.mode.initial", "recover", force_add=True)
    return new


def record(
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    *,
    measured: Sequence[str],
    impulses: Sequence[float],
    starts: int,
    seed: int = 0,
    servos: bool = True,
    world: str | None = None,
    console: Console = QUIET,
) -> tuple[History, float]:
    """Pushes a policy from 24 directions, and runs as many trials without a push as of one size.

    Args:
        env_cfg: config of the env.
        actor: the policy; ``None`` for a baseline.
        measured: keys that the network is to see, in order.
        impulses: dimensionless sizes of the pushes.
        starts: trials per direction and size.
        seed: of the trials, of noise and delays, and of when a push begins.
        servos: whether the servos act at all.
        world: battery whose hardware is met, ``twin``; ``None``: that of the env.
        console: for the progress bar.

    Returns:
        The trials, and the control step [s].

    Raises:
        ValueError: on a key that the env does not have, or numbers that no trial can have.
    """
    battery = load_battery(
        "planar",
        impulses=list(impulses),
        starts=starts,
        directions=24,
        push_time=PUSH_TIME,
        end_time=PUSH_TIME + SPREAD + 2.5,
        world=world_of(world),
    )
    worlds = pushed_worlds(battery, env_cfg, seed=seed, servos=servos)
    base, count = worlds.env.base_env, len(worlds.trials)
    if missing := [key for key in measured if key not in worlds.env.observation_spec.keys()]:
        raise ValueError(f"measured must name keys of the env, got {missing[0]}.")
    steps: list[list[Tensor]] = []
    live = torch.ones(base.num_envs, dtype=torch.bool)
    for td in worlds.play(actor, battery.end_time, console):
        live = live & ~(body_contact(td, td) | td["diverged"]).squeeze(-1)
        seen = torch.cat([read_measured(td, key).flatten(1) for key in measured], -1)
        rate = td["base_angular_velocity"].norm(dim=-1)
        steps.append([seen, tilt(td["base_orientation"]), rate, live])
    seen, lean, rate, alive = (
        torch.stack(column, 1)[:count] for column in zip(*steps, strict=True)
    )
    time = base.control_dt * torch.arange(1, len(steps) + 1)
    pushed = time > worlds.pushes.time[:count] + 1e-6
    return History(seen, lean, rate, alive, ~live[:count], pushed), base.control_dt


def labels(history: History) -> Tensor:
    """Whether each trial will end on the floor ``(K, T)``; 0 before the push."""
    return (history.fell[:, None] & history.pushed).float()


def split(history: History, order: Tensor) -> list[History]:
    """Three parts of 60, 20 and 20 % of the trials, which are taken in this order.

    Raises:
        ValueError: if one of them has no falls, or nothing but falls.
    """
    count = len(order)
    cuts = order.tensor_split([int(0.6 * count), int(0.8 * count)])
    parts = [History(*(value[rows] for value in history)) for rows in cuts]
    for part in parts:
        if part.fell.all() or not part.fell.any():
            raise ValueError(
                "impulses and starts must give trials that fall and that do not, in each of "
                f"three parts; of {len(part.fell)} {int(part.fell.sum())} fell."
            )
    return parts
