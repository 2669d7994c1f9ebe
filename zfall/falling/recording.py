"""Records states in the midst of falls, from which episodes begin."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.terms.falls import body_contact
from zfall.errors import check_number
from zfall.evaluation.definitions import load_battery
from zfall.falling.banks import ESTIMATES, PUSH_KEYS, SEEN_KEYS
from zfall.falling.modes import KNEEL
from zfall.falling.pushed import PUSH_TIME, SPREAD, pushed_worlds, world_of
from zfall.terminal import QUIET
from zfall.values import Key

_KEYS = (*STATE_KEYS, *SEEN_KEYS)
_EPS = 1e-6  # [s]


class Recording(NamedTuple):
    """What came of pushed trials.

    Attributes:
        states: ``(K, ...)`` float32 under ``STATE_KEYS``, ``SEEN_KEYS``, ``PUSH_KEYS`` and those
            of ``ESTIMATES`` that the env has, as ``save_bank`` takes them.
        trials: their number.
        fell: how many of them fell.
    """

    states: dict[str, Tensor]
    trials: int
    fell: int


def record_falls(
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    *,
    times: Sequence[float] | None,
    points: Sequence[str],
    impulses: Sequence[float],
    starts: int,
    duration: float = 0.1,
    seed: int = 0,
    servos: bool = True,
    world: str | None = None,
    console: Console = QUIET,
) -> Recording:
    """Pushes a policy from 24 directions and keeps states of its falls.

    With ``times`` the states are those nearest to these times after the push began, of trials that
    end on the floor; states after the first touch do not count. With ``None`` there is one state
    a trial, that of the step in which the policy's own mode machine gives up.

    Args:
        env_cfg: config of the env.
        actor: the policy; ``None`` for a baseline.
        times: after the push began [s]; ``None``: at the trigger.
        points: push points, each tried with all else.
        impulses: dimensionless sizes of the pushes.
        starts: trials per direction, size and point.
        duration: of the pushes [s].
        seed: of the trials, and of when a push begins.
        servos: whether the servos act at all.
        world: battery whose hardware is met, ``twin``; ``None``: that of the env.
        console: for the progress bar.

    Raises:
        ValueError: on numbers that no trial can have, if the env has no modes but ``times`` is
            ``None``, or if no state fits.
    """
    check_number(duration, "duration", lambda x: 0 < x < 1.9, "lie in (0, 1.9) s")
    if times is None and env_cfg.transforms.get("mode") is None:
        raise ValueError("times must be a list of a policy without modes, which never gives up.")
    battery = load_battery(
        "envelope",  # which may push at several points
        point=list(points),
        impulses=list(impulses),
        starts=starts,
        duration=duration,
        push_time=PUSH_TIME,
        end_time=PUSH_TIME + SPREAD + 2.0,
        directions=24,
        world=world_of(world),
    )
    worlds = pushed_worlds(battery, env_cfg, seed=seed, servos=servos, control_arm=False)
    base, count = worlds.env.base_env, len(worlds.trials)
    there = worlds.env.observation_spec.keys(True)
    estimated = {("measured", key): name for name, key in ESTIMATES.items()}
    seen: dict[Key, str] = {key: key for key in _KEYS}  # where it is, and its name in the bank
    seen |= {key: name for key, name in estimated.items() if key in there}
    moment = _AtTrigger(base.num_envs) if times is None else _AtTimes(times, base.control_dt)
    fell, moments = torch.zeros(base.num_envs, dtype=torch.bool), []
    force = torch.from_numpy(worlds.trials["force_n"].to_numpy()[worlds.rows]).float()
    heading = torch.from_numpy(worlds.trials["direction_rad"].to_numpy()[worlds.rows]).float()
    applied = torch.stack([force * heading.cos(), force * heading.sin(), 0.0 * force], -1)
    for step, td in enumerate(worlds.play(actor, battery.end_time, console), 1):
        fell |= body_contact(td, td).squeeze(-1)
        since_push = step * base.control_dt - worlds.pushes.time[:, 0].float()  # [s]
        kept = moment.is_now(td, since_push)
        if not kept.any():
            continue
        remains = (duration - since_push).clamp_min(0.0)[:, None]
        values = [td[key].flatten(1) for key in seen]
        state = torch.cat([*values, applied * (remains > _EPS), remains], -1)
        moments.append(torch.where((kept & ~fell)[:, None], state, torch.nan))
    if not moments:
        raise ValueError("impulses or times must give a state to record, no trial has one.")
    states = torch.stack(moments, 1)[:count]
    if times is not None:  # at a trigger those count, too, that might not have fallen
        states = states[fell[:count]]
    table = states.flatten(0, 1)
    table = table[~table.isnan().any(-1)]
    parts = table.split([*(td[key][0].numel() for key in seen), 3, 1], -1)
    arrays = dict(zip((*seen.values(), *PUSH_KEYS), parts, strict=True))
    arrays["base_position"][:, :2] = 0.0
    return Recording(arrays, count, int(fell[:count].sum()))


class _AtTimes:
    """Steps nearest to given times after the push began."""

    def __init__(self, times: Sequence[float], control_dt: float):
        self.times, self.control_dt = torch.tensor(list(times)), control_dt

    def is_now(self, td: TensorDictBase, since_push: Tensor) -> Tensor:
        """Worlds in which it is such a step ``(N,)`` bool."""
        off = since_push[:, None] - self.times + 0.5 * self.control_dt
        near = ((off > -_EPS) & (off < self.control_dt - _EPS)).any(-1)
        return near & (since_push > -_EPS)


class _AtTrigger:
    """The step after the push began in which the mode machine first gives up."""

    def __init__(self, worlds: int):
        self.given_up = torch.zeros(worlds, dtype=torch.bool)

    def is_now(self, td: TensorDictBase, since_push: Tensor) -> Tensor:
        """Worlds in which it is this step ``(N,)`` bool."""
        kneels = td["mode"][:, KNEEL] > 0
        kept = kneels & ~self.given_up & (since_push > _EPS)
        self.given_up |= kneels
        return kept
