"""Records the midst of falls, from which kneeling is learned: ``python -m recipes.falls run=best``.

A policy is pushed from all sides, at the torso and at the pelvis, by more than it withstands. Of
every trial that ends on the floor the states 0.12 and 0.16 s after the push began are kept:
later there is no time left, a fall takes 0.3 s.
"""

from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from recipes.one_line import check_keys, one_line_errors, start
from recipes.tested import load_run
from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.terms.falls import body_contact
from zfall.evaluation.battery import arrange, battery_env, play, robot_of
from zfall.evaluation.definitions import load_battery, plan_pushes, plan_trials

TIMES = (0.12, 0.16)  # [s]


@hydra.main(version_base=None, config_path=".", config_name="falls")
def main(cfg: DictConfig) -> None:
    """Writes ``falls.npz``: arrays ``(K, ...)`` float32 by the names of ``STATE_KEYS``."""
    console = Console()
    with one_line_errors():
        check_keys(cfg, {"run", "checkpoint", "env", "change", "seed", "starts", "impulses"})
        env_cfg, actor = load_run(cfg, cfg.run)
    battery = load_battery(
        "envelope",  # which may push at several points
        point=["torso", "pelvis"],
        impulses=list(cfg.impulses),
        starts=cfg.starts,
        push_time=0.52,  # whole control steps of 20 and 40 ms
        end_time=2.5,
        directions=24,
    )
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, cfg.seed)
    trials = trials[trials["impulse"] > 0].reset_index(drop=True)
    env, begin, push = battery_env(battery, env_cfg, 64 * -(-len(trials) // 64))
    base = env.base_env
    rows = np.arange(base.num_envs).clip(max=len(trials) - 1)
    pushes = plan_pushes(battery, trials)[rows]
    arrange(battery, trials.iloc[rows], pushes, base, begin, push)
    moments, fell = [], torch.zeros(base.num_envs, dtype=torch.bool)
    steps = round(battery.end_time / base.control_dt)
    for step, td in enumerate(play(env, actor, steps), 1):
        fell |= body_contact(td, td).squeeze(-1)
        since_push = step * base.control_dt - battery.push_time
        if any(abs(since_push - time) < 0.5 * base.control_dt for time in TIMES):
            state = torch.cat([td[key] for key in STATE_KEYS], -1)
            moments.append(torch.where(fell[:, None], torch.nan, state))
    states = torch.stack(moments, 1)[: len(trials)][fell[: len(trials)]].flatten(0, 1)
    table = states[~states.isnan().any(-1)]
    sizes = [td[key].shape[-1] for key in STATE_KEYS]
    arrays = dict(zip(STATE_KEYS, table.split(sizes, -1), strict=True))
    arrays["base_position"][:, :2] = 0.0
    path = Path(HydraConfig.get().runtime.output_dir) / "falls.npz"
    np.savez_compressed(path, **{key: value.numpy() for key, value in arrays.items()})
    console.print(f"{int(fell[: len(trials)].sum())} of {len(trials)} trials fell")
    console.print(f"wrote {path}: {len(table)} states")


if __name__ == "__main__":
    start(main)
