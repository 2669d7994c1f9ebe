"""How fast the bare physics, an env and a training are, in control steps per second."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import mujoco
import torch
from omegaconf import DictConfig
from torch import Tensor
from torchrl.envs import Transform

from zfall.configs import compose_config
from zfall.cores import usable_cores
from zfall.envs.humanoid import HumanoidEnv
from zfall.simulation.turns import in_turns, physics_first
from zfall.training.collection import Worlds
from zfall.training.learner import Learner
from zfall.training.loop import garbage_collector_of_new_things
from zfall.training.stages import stages_of

ROUNDS = 8  # every figure is measured once in each: the machine's speed drifts

Task = Callable[[float], float]  # measures for some seconds, returns control steps/s


def in_rounds(
    tasks: dict[str, Task], seconds: float, report: Callable[[str], None]
) -> dict[str, float]:
    """Control steps/s of each task, measured in several rounds of all.

    Args:
        tasks: by name.
        seconds: for each task, over all rounds.
        report: is called with what is measured next.
    """
    speeds: dict[str, list[float]] = {name: [] for name in tasks}
    with garbage_collector_of_new_things():
        for number in range(ROUNDS):
            for name, task in tasks.items():
                report(f"{name}, {number + 1} of {ROUNDS}")
                speeds[name].append(task(seconds / ROUNDS))
    return {name: ROUNDS / sum(1 / v for v in values) for name, values in speeds.items()}


def bare_physics(base: HumanoidEnv, states: Tensor, controls: Tensor, seconds: float) -> float:
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
    return usable_cores() * done / (time.perf_counter() - began)


def bare_physics_together(
    base: HumanoidEnv, states: Tensor, controls: Tensor, seconds: float
) -> float:
    """As ``bare_physics``, but measured on all cores at once, which share caches and clock."""
    cores = usable_cores()
    with ThreadPoolExecutor(cores) as pool:
        runs = [pool.submit(bare_physics, base, states, controls, seconds) for _ in range(cores)]
    return sum(done.result() for done in runs) / cores


class OwnPhysics:
    """The physics of an env as it runs it: all worlds at once, servos included, and nothing else.

    Replays states and controls, like ``bare_physics``; no transform, no quantity, no reset.

    Args:
        cfg: of the training whose worlds they are.
        states: recorded before control steps ``(K N, size)``.
        controls: targets in these ``(K N, J)`` [rad].
    """

    def __init__(self, cfg: DictConfig, states: Tensor, controls: Tensor):
        env = Worlds(cfg.env, cfg.num_envs, 1).env
        env.reset()  # which draws what differs from world to world
        self.base: HumanoidEnv = env.base_env
        end = 1 + self.base.simulation.model.nq  # the state begins with the time
        rows = states[:, 1 : end + self.base.simulation.model.nv].split(cfg.num_envs)
        self.states = [row.tensor_split([end - 1], 1) for row in rows]
        ordered = controls.double()[:, self.base._to_actuators]
        inputs = ordered[:, None].expand(-1, self.base.substeps, -1)
        self.controls = inputs.split(cfg.num_envs)

    def run(self, seconds: float) -> float:
        """Control steps/s of all worlds."""
        simulation, servos, done = self.base.simulation, self.base.servo_dynamics, 0
        began = time.perf_counter()
        with physics_first():
            while time.perf_counter() - began < seconds:
                qpos, qvel = self.states[done % len(self.states)]
                simulation.qpos.copy_(qpos)
                simulation.qvel.copy_(qvel)
                if servos:
                    servos.act(simulation)
                sensors = simulation.step(self.controls[done % len(self.controls)])
                if servos:
                    servos.advance(simulation, sensors)
                done += 1
        return done * simulation.num_worlds / (time.perf_counter() - began)


def whole_training(learner: Learner, seconds: float) -> float:
    """Control steps/s of collecting and learning."""
    frames, began = learner.frames, time.perf_counter()
    while time.perf_counter() - began < seconds:
        learner.learn(learner.collect())
    return (learner.frames - frames) / (time.perf_counter() - began)


def loss_shares(learner: Learner, rounds: int = 4) -> dict[str, float]:
    """What each auxiliary loss adds to the time of an update, as a share of that without."""
    batch, losses = learner.collect(), learner.losses
    variants = {"": {}, **{place: {place: loss} for place, loss in losses.auxiliary.items()}}
    spent = dict.fromkeys(variants, 0.0)
    for _ in range(rounds):
        for place, auxiliary in variants.items():
            learner.losses = replace(losses, auxiliary=auxiliary)
            began = time.perf_counter()
            learner.learn(batch.clone())
            spent[place] += time.perf_counter() - began
    learner.losses = losses
    began = time.perf_counter()
    for _ in range(rounds):
        learner.collect()
    update = time.perf_counter() - began + spent[""]
    return {
        place.removeprefix("auxiliary_losses."): (spent[place] - spent[""]) / update
        for place in losses.auxiliary
    }


class EnvStepper:
    """Steps worlds with the actions of a policy drawn beforehand, resets included.

    Args:
        cfg: of the training whose worlds they are.
        learner: whose actor draws the actions.
        groups: number of groups of worlds, as in ``recipes.train``.
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

    def step(self, group: int) -> Tensor:
        """One control step of a group of worlds; returns its targets ``(N, J)`` [rad]."""
        td, count = self._tds[group], self._counts[group]
        td["action"] = self._actions[count % len(self._actions)][group]
        data, self._tds[group] = self.envs[group].step_and_maybe_reset(td)
        self._counts[group] += 1
        return data["next", "target"]

    def run(self, seconds: float) -> float:
        """Control steps/s of all worlds; groups take turns as they do in training."""
        began, before = time.perf_counter(), list(self._counts)

        def go_on(group: int) -> int:
            while time.perf_counter() - began < seconds:
                self.step(group)
            return (self._counts[group] - before[group]) * self.envs[group].batch_size.numel()

        with physics_first():
            done = sum(in_turns([partial(go_on, group) for group in range(len(self.envs))]))
        return done / (time.perf_counter() - began)

    def record(self, steps: int = 40) -> tuple[Tensor, Tensor]:
        """States before a step ``(K, size)`` and targets in it ``(K, J)``, of all worlds."""
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
        with _timed([list(env.transform) for env in self.envs], spent):
            began = time.perf_counter()
            self.run(seconds)
            passed = time.perf_counter() - began
        return {key: value / passed for key, value in spent.items()}


@contextmanager
def _timed(tables: list[list[Transform]], spent: dict[str, float]) -> Iterator[None]:
    """Adds the time that transforms take to ``spent``, by ``transform/NAME``."""
    methods = ("_inv_call", "_step", "_reset", "_reset_env_preprocess")
    for table in tables:
        seen: set[str] = set()
        for transform in table:
            key = f"transform/{type(transform).__name__}"
            while key in seen:
                key += "'"
            seen.add(key)
            spent.setdefault(key, 0.0)
            for method in methods:
                setattr(transform, method, _adding(getattr(transform, method), spent, key))
    try:
        yield
    finally:
        for transform in (transform for table in tables for transform in table):
            for method in methods:
                delattr(transform, method)


def _adding(function: Callable[..., Any], spent: dict[str, float], key: str) -> Callable[..., Any]:
    """The function, adding the time it takes to ``spent[key]``."""

    def call(*args: Any) -> Any:
        began = time.perf_counter()
        result = function(*args)
        spent[key] += time.perf_counter() - began
        return result

    return call


def measure_experiment(cfg: DictConfig, report: Callable[[str], None]) -> dict[str, float]:
    """Limit, env and training of one experiment, its env driven by its own untrained policy.

    Args:
        cfg: of ``recipes.bench``.
        report: called with what comes next.
    """
    overrides = [f"experiment={cfg.only}", f"num_envs={cfg.num_envs}", f"seed={cfg.seed}"]
    trained = [stage for stage in stages_of(compose_config(overrides)) if stage.make is None]
    learner = Learner(trained[-1].config)
    stepper, undivided = (EnvStepper(learner.cfg, learner, n) for n in (learner.cfg.groups, 1))
    recorded = stepper.record()
    tasks: dict[str, Task] = {
        "limit": partial(bare_physics, stepper.base_env, *recorded),
        "limit_together": partial(bare_physics_together, stepper.base_env, *recorded),
        "physics": OwnPhysics(learner.cfg, *undivided.record()).run,
        "env": stepper.run,
        "env_undivided": undivided.run,
        "train": partial(whole_training, learner),
    }
    results = in_rounds(tasks, cfg.seconds, report)
    for name in ("env", "env_undivided", "train"):
        results[f"{name}_efficiency"] = results[name] / results["limit"]
    results["env_of_physics"] = results["env"] / results["physics"]
    report("transforms")
    return results | stepper.transform_shares(cfg.seconds / 2)
