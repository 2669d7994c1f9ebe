"""Speed against the bare physics and against peers, in one run: ``python -m recipes.bench``."""

import json
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import hydra
import mujoco
import torch
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from benchmarks.peers import measure_peers, memory_per_world
from recipes.shell import one_line_errors, start
from zfall.training.loop import garbage_collector_of_new_things
from zfall.envs.humanoid import HumanoidEnv
from zfall.errors import check_flags, check_keys, check_number
from zfall.simulation.turns import in_turns, physics_first
from zfall.training.collection import Worlds
from zfall.training.learner import Learner
from zfall.training.run_folder import write_config

FULL = "env=push_recovery_realistic"  # every kind of transform at once
LOSSES = ["caps=atalante", "symmetry=loss"]  # beside PPO's
ROUNDS = 8  # every figure is measured once in each: the machine's speed drifts


@hydra.main(version_base=None, config_path=".", config_name="bench")
def main(cfg: DictConfig) -> None:
    """Prints the ratios and writes ``bench.json`` into the run folder."""
    console = Console()
    with one_line_errors(), console.status("setting up") as status:
        check_keys(cfg, {"num_envs", "seconds", "rollout_steps", "seed", "peers", "only"})
        check_flags(cfg, ["peers"])
        check_number(cfg.seconds, "seconds", lambda x: 0 < x < math.inf, "be positive and finite")
        measuring = measure if cfg.only is None else measure_experiment
        results = measuring(cfg, lambda name: status.update(f"measuring {name}"))
    folder = Path(HydraConfig.get().runtime.output_dir)
    write_config(cfg, HydraConfig.get().overrides.task, folder)
    (folder / "bench.json").write_text(json.dumps(results, indent=2))
    out = Table(title=f"{cfg.num_envs} worlds, {len(os.sched_getaffinity(0))} cores")
    out.add_column("figure")
    out.add_column("value", justify="right")
    for key, value in results.items():
        share = key.startswith(("transform/", "loss/")) or key.endswith("_efficiency")
        unit = "KiB" if key == "memory_per_world" else "control steps/s"
        out.add_row(key, f"{value:.3f}" if share else f"{value:.0f} {unit}")
    console.print(out, f"wrote {folder}/bench.json")


def measure(cfg: DictConfig, report: Callable[[str], None]) -> dict[str, float]:
    """All figures, by the names of ``bench.json``; ``report`` is told what is measured."""
    overrides = [f"{k}={cfg[k]}" for k in ("num_envs", "rollout_steps", "seed")]
    mlp = Learner(compose("train", overrides=overrides))
    gru = Learner(compose("train", overrides=[*overrides, "actor=gru_mog"]))
    mlp_losses = Learner(compose("train", overrides=[*overrides, *LOSSES]))
    gru_losses = Learner(compose("train", overrides=[*overrides, *LOSSES, "actor=gru_mog"]))
    for learner in (mlp, gru, mlp_losses, gru_losses):  # warm up, and have policies that move
        learner.learn(learner.collect())
    full_cfg = compose("train", overrides=[*overrides, FULL])
    stepper, full_stepper = (EnvStepper(c, mlp, c.groups) for c in (mlp.cfg, full_cfg))
    undivided = EnvStepper(mlp.cfg, mlp, 1)
    recorded, full_recorded = stepper.record(), full_stepper.record()
    tasks: dict[str, Callable[[float], float]] = {
        "limit": lambda seconds: bare_physics(stepper.base_env, *recorded, seconds),
        "limit_full": lambda seconds: bare_physics(full_stepper.base_env, *full_recorded, seconds),
        "limit_together": lambda seconds: together(stepper.base_env, *recorded, seconds),
        "env": stepper.run,
        "env_undivided": undivided.run,
        "env_full": full_stepper.run,
        "train_mlp": lambda seconds: train(mlp, seconds),
        "train_gru": lambda seconds: train(gru, seconds),
        "train_mlp_losses": lambda seconds: train(mlp_losses, seconds),
        "train_gru_losses": lambda seconds: train(gru_losses, seconds),
    }
    results = in_rounds(tasks, cfg.seconds, report)
    for name in ("env", "env_undivided", *(name for name in tasks if name.startswith("train"))):
        results[f"{name}_efficiency"] = results[name] / results["limit"]
    # Its physics has a ball too, that rests on the floor of every world.
    results["env_full_efficiency"] = results["env_full"] / results["limit_full"]
    report("losses")
    for name, learner in (("mlp", mlp_losses), ("gru", gru_losses)):
        results |= {f"loss/{k}_{name}": v for k, v in loss_shares(learner).items()}
    report("transforms")
    results |= full_stepper.transform_shares(cfg.seconds / 2)
    if cfg.peers:
        report("memory")
        results["memory_per_world"] = memory_per_world()
        results |= measure_peers(torch.stack(stepper.actions), cfg.seconds / 2, report)
    return results


def measure_experiment(cfg: DictConfig, report: Callable[[str], None]) -> dict[str, float]:
    """Limit, env and training of one experiment, its env driven by its own untrained policy."""
    overrides = [f"experiment={cfg.only}", f"num_envs={cfg.num_envs}", f"seed={cfg.seed}"]
    learner = Learner(compose("train", overrides=overrides))
    stepper, undivided = (EnvStepper(learner.cfg, learner, n) for n in (learner.cfg.groups, 1))
    recorded = stepper.record()
    tasks: dict[str, Callable[[float], float]] = {
        "limit": lambda seconds: bare_physics(stepper.base_env, *recorded, seconds),
        "limit_together": lambda seconds: together(stepper.base_env, *recorded, seconds),
        "env": stepper.run,
        "env_undivided": undivided.run,
        "train": lambda seconds: train(learner, seconds),
    }
    results = in_rounds(tasks, cfg.seconds, report)
    for name in ("env", "env_undivided", "train"):
        results[f"{name}_efficiency"] = results[name] / results["limit"]
    report("transforms")
    return results | stepper.transform_shares(cfg.seconds / 2)


def in_rounds(
    tasks: dict[str, Callable[[float], float]], seconds: float, report: Callable[[str], None]
) -> dict[str, float]:
    """Control steps/s of each task, measured in several rounds of all: the machine drifts."""
    speeds: dict[str, list[float]] = {name: [] for name in tasks}
    with garbage_collector_of_new_things():
        for number in range(ROUNDS):
            for name, task in tasks.items():
                report(f"{name}, {number + 1} of {ROUNDS}")
                speeds[name].append(task(seconds / ROUNDS))
    return {name: ROUNDS / sum(1 / v for v in values) for name, values in speeds.items()}


def bare_physics(
    base: HumanoidEnv, states: torch.Tensor, controls: torch.Tensor, seconds: float
) -> float:
    """Control steps/s that ``mj_step`` alone would do on all cores, measured on one thread.

    Replays recorded states ``(K, size)`` and controls ``(K, nu)``: contacts cost time.
    """
    model, data = base.simulation.model, mujoco.MjData(base.simulation.model)
    state_rows, control_rows = states.numpy(), controls.double().numpy()
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    done, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        index = done * 31 % len(states)  # spreads over worlds and times
        mujoco.mj_setState(model, data, state_rows[index], spec)
        data.ctrl[:] = control_rows[index]
        mujoco.mj_step(model, data, nstep=base.substeps)
        done += 1
    return len(os.sched_getaffinity(0)) * done / (time.perf_counter() - began)


def together(
    base: HumanoidEnv, states: torch.Tensor, controls: torch.Tensor, seconds: float
) -> float:
    """As ``bare_physics``, but measured on all cores at once, which share caches and clock."""
    cores = len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(cores) as pool:
        runs = [pool.submit(bare_physics, base, states, controls, seconds) for _ in range(cores)]
    return sum(done.result() for done in runs) / cores


def train(learner: Learner, seconds: float) -> float:
    """Control steps/s of collecting and learning."""
    frames, began = learner.frames, time.perf_counter()
    while time.perf_counter() - began < seconds:
        learner.learn(learner.collect())
    return (learner.frames - frames) / (time.perf_counter() - began)


def loss_shares(learner: Learner, rounds: int = 4) -> dict[str, float]:
    """What each loss beside PPO's adds to the time of an update, as a share of that without."""
    batch = learner.collect()
    losses = dict(zip(learner.cfg.auxiliary_losses, learner.auxiliary, strict=True))
    variants = {"": [], **{name: [loss] for name, loss in losses.items()}}
    spent = dict.fromkeys(variants, 0.0)
    for _ in range(rounds):
        for name, auxiliary in variants.items():
            learner.auxiliary = auxiliary
            began = time.perf_counter()
            learner.learn(batch.clone())
            spent[name] += time.perf_counter() - began
    learner.auxiliary = list(losses.values())
    began = time.perf_counter()
    for _ in range(rounds):
        learner.collect()
    update = time.perf_counter() - began + spent[""]
    return {name: (spent[name] - spent[""]) / update for name in losses}


class EnvStepper:
    """Steps worlds with the actions of a policy drawn beforehand, resets included.

    Args:
        cfg: of the training whose worlds they are.
        learner: whose actor draws the actions.
        groups: in which the worlds take turns, as in ``recipes.train``.
    """

    def __init__(self, cfg: DictConfig, learner: Learner, groups: int | None):
        self.worlds = Worlds(cfg.env, cfg.num_envs, groups)
        self.envs = self.worlds.envs
        self.actions = learner.collect()["action"].unbind(1)
        sizes = [env.batch_size.numel() for env in self.envs]
        self._actions = [action.split(sizes) for action in self.actions]
        self.worlds.begin(cfg.seed)
        self._tds = self.worlds.carriers
        self._counts = [0] * len(self.envs)

    @property
    def base_env(self) -> HumanoidEnv:
        """The first of the base envs."""
        return self.envs[0].base_env

    def step(self, group: int) -> torch.Tensor:
        """One control step of a group of worlds; returns its targets."""
        td, count = self._tds[group], self._counts[group]
        td["action"] = self._actions[count % len(self._actions)][group]
        data, self._tds[group] = self.envs[group].step_and_maybe_reset(td)
        self._counts[group] += 1
        return data["next", "target"]

    def run(self, seconds: float) -> float:
        """Control steps/s of all worlds, which take turns as they do in training."""
        began, before = time.perf_counter(), list(self._counts)

        def go_on(group: int) -> int:
            while time.perf_counter() - began < seconds:
                self.step(group)
            return (self._counts[group] - before[group]) * self.envs[group].batch_size.numel()

        with physics_first():
            done = sum(in_turns([partial(go_on, group) for group in range(len(self.envs))]))
        return done / (time.perf_counter() - began)

    def record(self, steps: int = 40) -> tuple[torch.Tensor, torch.Tensor]:
        """States before a step and targets in it, of all worlds and some steps."""
        states, controls = [], []
        for _ in range(steps):
            for group, env in enumerate(self.envs):
                states.append(env.base_env.simulation.state_dict()["state"])
                controls.append(self.step(group))
        return torch.cat(states), torch.cat(controls)

    def transform_shares(self, seconds: float) -> dict[str, float]:
        """Share of each transform in the time that passes, ``transform/NAME``.

        The physics of other worlds goes on meanwhile: not all of it would be saved.
        """
        spent: dict[str, float] = {}
        for env in self.envs:
            seen: set[str] = set()
            for transform in env.transform:
                key = f"transform/{type(transform).__name__}"
                while key in seen:
                    key += "'"
                seen.add(key)
                spent.setdefault(key, 0.0)
                for method in ("_inv_call", "_step", "_reset", "_reset_env_preprocess"):
                    setattr(transform, method, timed(getattr(transform, method), spent, key))
        began = time.perf_counter()
        self.run(seconds)
        passed = time.perf_counter() - began
        return {key: value / passed for key, value in spent.items()}


def timed(function: Callable[..., Any], spent: dict[str, float], key: str) -> Callable[..., Any]:
    """The function, adding the time it takes to ``spent[key]``."""

    def call(*args: Any) -> Any:
        began = time.perf_counter()
        result = function(*args)
        spent[key] += time.perf_counter() - began
        return result

    return call


if __name__ == "__main__":
    start(main)
