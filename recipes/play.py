"""Lets a policy act in its task, pushes on request, and films it: ``recipes.play run=DIR``."""

import json
from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import track
from torchrl.envs import TransformedEnv
from torchrl.modules.utils import get_primers_from_module

from recipes.shell import one_line_errors, start
from zfall.commands import remove_if_empty, shown_path
from zfall.envs.make import left_out
from zfall.envs.tables import keep
from zfall.errors import check_flags, check_keys, check_lists, check_number, check_whole
from zfall.evaluation.battery import BLOCK, play
from zfall.evaluation.candidate import BASELINES, load_run
from zfall.evaluation.showcase import frame
from zfall.evaluation.video import film
from zfall.modules.actors import recurrent_keys

KEYS = {"run", "checkpoint", "env", "num_envs", "seconds", "seed", "keep", "video"}


@hydra.main(version_base=None, config_path=".", config_name="play")
def main(cfg: DictConfig) -> None:
    """Writes ``play.json`` and ``play.mp4`` into the run folder, or hydra's if there is none."""
    console = Console()
    with one_line_errors():
        check_keys(cfg, KEYS)
        if cfg.run is None:
            raise ValueError(
                f"run must be a run folder, a policy that ships or {' or '.join(BASELINES)}."
            )
        if cfg.run not in BASELINES and cfg.get("env") is not None:
            raise ValueError(f"env must be given for baselines alone, {cfg.run} has its own.")
        check_lists(cfg, ["keep"])
        check_whole(cfg, ["num_envs"], 1)
        check_whole(cfg, ["seed"])
        check_flags(cfg, ["video"])
        check_number(cfg.seconds, "seconds", lambda x: x > 0, "be positive")
        env_cfg, actor = load_run(cfg, cfg.run)
        env_cfg = keep(env_cfg, cfg.keep)
        worlds = BLOCK * -(-cfg.num_envs // BLOCK)
        world = {"num_envs": worlds, "servos": cfg.run != "limp"}
        env = instantiate(env_cfg, base_env=world, training=False)
        if not cfg.seconds >= (step := env.base_env.control_dt):
            raise ValueError(f"seconds must be at least control_dt {step}, got {cfg.seconds}.")
    gone = left_out(OmegaConf.select(env_cfg, "training_only", default={}))
    console.print(f"of the env's transforms left out: {', '.join(gone) or 'nothing'}")
    if worlds != cfg.num_envs:
        console.print(f"num_envs: {worlds}, for worlds are played by {BLOCK}")
    if actor is not None and recurrent_keys(actor):
        env.append_transform(get_primers_from_module(actor))
    env.set_seed(cfg.seed)
    results, states, forces = walk(env, actor, cfg.seconds, console)
    output = Path(HydraConfig.get().runtime.output_dir)
    folder = Path(cfg.run) if Path(cfg.run).is_dir() else output  # one that ships has none
    (folder / "play.json").write_text(json.dumps(results, indent=2))
    written = "play.json"
    for key, value in results.items():
        console.print(f"{key}: {value:.3g}")
    if cfg.video:
        base = env.base_env
        rows, columns = {Path(cfg.run).name: states}, [f"world {i}" for i in range(states.shape[1])]
        try:
            film(base.simulation.model, rows, columns, forces, folder / "play.mp4", dt=frame(base))
            written += ", play.mp4"
        except RuntimeError as error:
            console.print(f"no video: {error}")
    console.print(f"wrote {shown_path(folder)}/{written}", soft_wrap=True)
    remove_if_empty(output)  # the results lie in the run folder


def walk(
    env: TransformedEnv, actor: torch.nn.Module | None, seconds: float, console: Console
) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """How far the robot gets, and what the film shows.

    Returns:
        ``worlds``; ``fell``, how many of them did within the time; ``seconds``, mean time that
        they stood or walked; ``forward_velocity`` [m/s], mean over that time of the base's velocity
        along the way the robot faces; ``distance`` [m], mean from begin to end of it, on the
        level. Then positions ``(T, 4, nq)`` and forces ``(T, 4, 3)`` of the first four worlds.
    """
    base = env.base_env
    steps, every = round(seconds / base.control_dt), round(frame(base) / base.control_dt)
    up = torch.ones(env.num_envs, dtype=torch.bool)
    began = last = torch.zeros(0)
    upright, ways = torch.zeros(env.num_envs), torch.zeros(env.num_envs)
    states, forces = [], []
    for step, td in enumerate(
        track(play(env, actor, steps), "playing", total=steps, console=console, transient=True)
    ):
        place = td["base_position"][:, :2]
        if step == 0:
            began = last = place
        up = up & ~td["terminated"][:, 0]
        w, x, y, z = td["base_orientation"].unbind(-1)
        heading = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y.square() + z.square()))
        facing = torch.stack([heading.cos(), heading.sin()], -1)
        way = (td["base_linear_velocity"][:, :2] * facing).sum(-1)
        ways += way * up
        upright += up
        last = torch.where(up[:, None], place, last)
        if step % every == 0:
            states.append(base.simulation.qpos[:4].numpy().copy())
            push = td.get(("push", "force"), torch.zeros(4, 3))
            forces.append(push[:4].numpy().copy())
    results = {
        "worlds": float(env.num_envs),
        "fell": float((~up).sum()),
        "seconds": float(upright.mean()) * base.control_dt,
        "forward_velocity": float((ways / upright.clamp_min(1)).mean()),
        "distance": float((last - began).norm(dim=-1).mean()),
    }
    return results, np.stack(states), np.stack(forces)


if __name__ == "__main__":
    start(main)
