"""Records the midst of falls, from which kneeling is learned: ``python -m recipes.falls run=best``.

A policy is pushed from all sides, at the torso and at the pelvis, by more than it withstands. Of
every trial that ends on the floor the states are kept in which the trunk first leaned by 0.3, 0.4,
0.5 and 0.6 rad before anything but the feet touched.
"""

from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from torch import Tensor

from recipes.one_line import check_keys, one_line_errors, start
from recipes.tested import load_run
from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.rotations import tilt
from zfall.envs.terms.falls import body_contact
from zfall.evaluation.battery import battery_env, play, start_positions
from zfall.evaluation.definitions import load_battery, plan_pushes, plan_trials

ANGLES = (0.3, 0.4, 0.5, 0.6)  # [rad]


@hydra.main(version_base=None, config_path=".", config_name="falls")
def main(cfg: DictConfig) -> None:
    """Writes ``falls.npz``: arrays ``(K, ...)`` float32 by the names of ``STATE_KEYS``."""
    console = Console()
    with one_line_errors():
        check_keys(cfg, {"run", "checkpoint", "env", "change", "seed", "starts", "impulses"})
        env_cfg, actor = load_run(cfg, cfg.run)
    battery = load_battery(
        "planar",
        point=["torso", "pelvis"],
        impulses=list(cfg.impulses),
        starts=cfg.starts,
        push_time=0.5,
        end_time=2.5,
        directions=24,
    )
    unit = 1.0
    trials = plan_trials(battery, unit, cfg.seed)
    trials = trials[trials["impulse"] > 0].reset_index(drop=True)
    env, begin, push = battery_env(battery, env_cfg, 64 * -(-len(trials) // 64))
    base = env.base_env
    trials["force_n"] = trials["impulse"] * base.robot.impulse_unit / trials["duration_s"]
    rows = np.arange(base.num_envs).clip(max=len(trials) - 1)
    begin.states["joint_position"] = start_positions(battery, trials.iloc[rows], base)
    pushes = plan_pushes(battery, trials)[rows]
    for buffer, value in ((push.plan, pushes.force), (push.index, pushes.point)):
        buffer[:, :1] = value
    push.time[:, 1:] = torch.inf
    kept: dict[float, list[tuple[Tensor, Tensor]]] = {angle: [] for angle in ANGLES}
    seen = {angle: torch.zeros(base.num_envs, dtype=torch.bool) for angle in ANGLES}
    fell = torch.zeros(base.num_envs, dtype=torch.bool)
    steps = round(battery.end_time / base.control_dt)
    for td in play(env, actor, steps):
        fell |= body_contact(td, td).squeeze(-1)
        lean = tilt(td["base_orientation"])
        state = torch.cat([td[key] for key in STATE_KEYS], -1)
        for angle in ANGLES:
            now = (lean > angle) & ~seen[angle] & ~fell
            seen[angle] |= lean > angle
            kept[angle].append((now.nonzero()[:, 0], state[now]))
    states = []
    for parts in kept.values():
        worlds, values = torch.cat([w for w, _ in parts]), torch.cat([v for _, v in parts])
        states.append(values[fell[worlds] & (worlds < len(trials))])
    table = torch.cat(states)
    sizes = [td[key].shape[-1] for key in STATE_KEYS]
    arrays = dict(zip(STATE_KEYS, table.split(sizes, -1), strict=True))
    arrays["base_position"][:, :2] = 0.0
    path = Path(HydraConfig.get().runtime.output_dir) / "falls.npz"
    np.savez_compressed(path, **{key: value.numpy() for key, value in arrays.items()})
    console.print(f"{int(fell[: len(trials)].sum())} of {len(trials)} trials fell")
    console.print(f"wrote {path}: {len(table)} states")


if __name__ == "__main__":
    start(main)
