"""Speed against the bare physics and against peers, in one run: ``python -m recipes.bench``."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.configs import compose_config, config_folder
from zfall.cores import usable_cores
from zfall.errors import SPOKEN
from zfall.values import Count, Name, Positive, Seed

from .shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.training.speed import Task


class Keys(TypedDict):
    """The keys of ``bench.yaml``."""

    num_envs: Count
    seconds: Positive
    rollout_steps: Count
    seed: Seed
    only: Name | None
    peers: bool


FULL = "env=push_recovery_realistic"  # every kind of transform at once
LOSSES = ["caps=atalante", "symmetry=loss"]  # added to PPO's


@hydra.main(version_base=None, config_path=".", config_name="bench")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Prints the ratios and writes ``bench.json`` into the run folder."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    from rich.console import Console
    from rich.table import Table

    from zfall.training.run_folder import write_config
    from zfall.training.speed import measure_experiment

    console = Console()
    with one_line_errors(), console.status("setting up") as status:
        if cfg.peers and cfg.only is None and not peers_are_there():
            cfg.peers = False
            console.print("peers are left out: benchmarks/ comes with a clone, not with the wheel")
        results = (measure if cfg.only is None else measure_experiment)(
            cfg, lambda name: status.update(f"measuring {name}")
        )
    folder = Path(HydraConfig.get().runtime.output_dir)
    write_config(cfg, HydraConfig.get().overrides.task, folder)
    (folder / "bench.json").write_text(json.dumps(results, indent=2))
    out = Table(title=f"{cfg.num_envs} worlds, {usable_cores()} cores")
    out.add_column("figure")
    out.add_column("value", justify="right")
    for key, value in results.items():
        share = key.startswith(("transform/", "loss/")) or key.endswith(
            ("_efficiency", "_of_physics")
        )
        unit = "KiB" if key == "memory_per_world" else "control steps/s"
        out.add_row(key, f"{value:.3f}" if share else f"{value:.0f} {unit}")
    console.print(out, f"wrote {folder}/bench.json")


def measure(cfg: DictConfig, report: Callable[[str], None]) -> dict[str, float]:
    """All figures, by the names of ``bench.json``; ``report`` is called with what comes next."""
    from zfall.training import speed
    from zfall.training.learner import Learner

    overrides = [f"{k}={cfg[k]}" for k in ("num_envs", "rollout_steps", "seed")]
    networks: dict[str, list[str]] = {"mlp": [], "gru": ["actor=gru_mog"]}
    added = {"": ["symmetry=none"], "_losses": LOSSES}
    given = {n + end: [*more, *net] for end, more in added.items() for n, net in networks.items()}
    learners = {k: Learner(compose_config([*overrides, *more])) for k, more in given.items()}
    for learner in learners.values():  # warm up, and have policies that move
        learner.learn(learner.collect())
    mlp, full_cfg = learners["mlp"], compose_config([*overrides, FULL])
    stepper, full_stepper = (speed.EnvStepper(c, mlp, c.groups) for c in (mlp.cfg, full_cfg))
    undivided = speed.EnvStepper(mlp.cfg, mlp, 1)
    recorded, full_recorded = stepper.record(), full_stepper.record()
    tasks: dict[str, Task] = {
        "limit": partial(speed.bare_physics, stepper.base_env, *recorded),
        "limit_full": partial(speed.bare_physics, full_stepper.base_env, *full_recorded),
        "limit_together": partial(speed.bare_physics_together, stepper.base_env, *recorded),
        "physics": speed.OwnPhysics(mlp.cfg, *undivided.record()).run,
        "env": stepper.run,
        "env_undivided": undivided.run,
        "env_full": full_stepper.run,
        **{
            f"train_{name}": partial(speed.whole_training, learner)
            for name, learner in learners.items()
        },
    }
    results = speed.in_rounds(tasks, cfg.seconds, report)
    for name in ("env", "env_undivided", *(name for name in tasks if name.startswith("train"))):
        results[f"{name}_efficiency"] = results[name] / results["limit"]
    results["env_of_physics"] = results["env"] / results["physics"]
    # Its physics has a ball too, that rests on the floor of every world.
    results["env_full_efficiency"] = results["env_full"] / results["limit_full"]
    report("losses")
    for name in ("mlp", "gru"):
        shares = speed.loss_shares(learners[f"{name}_losses"])
        results |= {f"loss/{k}_{name}": v for k, v in shares.items()}
    report("transforms")
    results |= full_stepper.transform_shares(cfg.seconds / 2)
    if cfg.peers:
        import torch

        from benchmarks.peers import measure_peers, memory_per_world

        report("memory")
        results["memory_per_world"] = memory_per_world()
        results |= measure_peers(torch.stack(stepper.actions), cfg.seconds / 2, report)
    return results


def peers_are_there() -> bool:
    """Whether what others would use can be measured: ``benchmarks/`` lies next to ``recipes/``."""
    return (config_folder().parent / "benchmarks" / "peers.py").is_file()


if __name__ == "__main__":
    start(main)
