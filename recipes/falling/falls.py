"""Records the midst of falls, from which kneeling is learned: ``python -m recipes.falling.falls run=best``.

A policy is pushed from all sides at some points by more than it withstands, beginning in any
physics step. Of every trial that ends on the floor the states nearest to some ``times`` after the
push began are kept, when a trigger may first tell: later there is no time left, a fall takes 0.3 s.
With ``times=null``, for a policy that kneels, it is the state at its own trigger, of all trials.
"""

from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from recipes.shell import one_line_errors, start
from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.tables import robot_of
from zfall.envs.terms.falls import body_contact
from zfall.errors import check_keys, check_lists, check_number, check_whole
from zfall.evaluation.battery import arrange, battery_env, play
from zfall.evaluation.candidate import load_run
from zfall.evaluation.definitions import load_battery, plan_pushes, plan_trials
from zfall.falling.falling_start import SEEN_KEYS
from zfall.falling.modes import KNEEL

KEYS = {
    "run",
    "checkpoint",
    "change",
    "seed",
    "starts",
    "impulses",
    "points",
    "duration",
    "times",
}


@hydra.main(version_base=None, config_path=".", config_name="falls")
def main(cfg: DictConfig) -> None:
    """Writes ``falls.npz``: arrays ``(K, ...)`` float32 by the names of ``STATE_KEYS``.

    ``push_force`` ``(K, 3)`` [N; world] goes on for ``push_left`` ``(K, 1)`` [s]. By the names of
    ``SEEN_KEYS`` there is what the policy saw then and no state tells.
    """
    console = Console()
    with one_line_errors():
        check_keys(cfg, KEYS)
        check_lists(cfg, ("impulses", "points", "times"))
        check_whole(cfg, ["seed"])
        check_number(cfg.duration, "duration", lambda x: 0 < x < 1.9, "lie in (0, 1.9) s")
        env_cfg, actor = load_run(cfg, cfg.run)
        if cfg.times is None and env_cfg.transforms.get("mode") is None:
            raise ValueError(f"times=null needs a policy that kneels, {cfg.run} has no modes.")
    battery = load_battery(
        "envelope",  # which may push at several points
        point=list(cfg.points),
        impulses=list(cfg.impulses),
        starts=cfg.starts,
        duration=cfg.duration,
        push_time=0.52,  # whole control steps of 20 and 40 ms; they begin somewhere in the last
        end_time=2.5,
        directions=24,
    )
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, cfg.seed)
    trials = trials[trials["impulse"] > 0].reset_index(drop=True)
    env, begin, push = battery_env(
        battery, env_cfg, 64 * -(-len(trials) // 64), servos=cfg.run != "limp"
    )
    base = env.base_env
    rows = np.arange(base.num_envs).clip(max=len(trials) - 1)
    pushes = plan_pushes(battery, trials).sooner(base.control_dt, base.physics_dt, cfg.seed)[rows]
    arrange(battery, trials.iloc[rows], pushes, base, begin, push)
    steps = round(battery.end_time / base.control_dt)
    fell, moments = torch.zeros(base.num_envs, dtype=torch.bool), []
    keys = (*STATE_KEYS, *SEEN_KEYS)
    given_up = torch.zeros_like(fell)  # by the mode machine
    force = torch.from_numpy(trials["force_n"].to_numpy()[rows]).float()
    heading = torch.from_numpy(trials["direction_rad"].to_numpy()[rows]).float()
    pushing = torch.stack([force * heading.cos(), force * heading.sin(), 0.0 * force], -1)
    for step, td in enumerate(play(env, actor, steps), 1):
        fell |= body_contact(td, td).squeeze(-1)
        since_push = step * base.control_dt - pushes.time[:, 0].float()  # [s]
        if cfg.times is None:
            now_kneels = td["mode"][:, KNEEL] > 0
            kept = now_kneels & ~given_up & (since_push > 1e-6)
            given_up |= now_kneels
        else:
            off = since_push[:, None] - torch.tensor(list(cfg.times)) + 0.5 * base.control_dt
            kept = ((off > -1e-6) & (off < base.control_dt - 1e-6)).any(-1) & (since_push > -1e-6)
        if not kept.any():
            continue
        remains = (cfg.duration - since_push).clamp_min(0.0)[:, None]
        values = [td[key].flatten(1) for key in keys]
        state = torch.cat([*values, pushing * (remains > 1e-6), remains], -1)
        moments.append(torch.where((kept & ~fell)[:, None], state, torch.nan))
    if not moments:
        raise SystemExit("error: no state was recorded: no push made it give up, or no times fit.")
    states = torch.stack(moments, 1)[: len(trials)]
    if cfg.times is not None:  # the machine gave up what might have stood
        states = states[fell[: len(trials)]]
    table = states.flatten(0, 1)
    table = table[~table.isnan().any(-1)]
    sizes = [td[key][0].numel() for key in keys]
    parts = table.split([*sizes, 3, 1], -1)
    arrays = dict(zip((*keys, "push_force", "push_left"), parts, strict=True))
    arrays["base_position"][:, :2] = 0.0
    path = Path(HydraConfig.get().runtime.output_dir) / "falls.npz"
    np.savez_compressed(path, **{key: value.numpy() for key, value in arrays.items()})
    console.print(f"{int(fell[: len(trials)].sum())} of {len(trials)} trials fell")
    console.print(f"wrote {path}: {len(table)} states", soft_wrap=True)


if __name__ == "__main__":
    start(main)
