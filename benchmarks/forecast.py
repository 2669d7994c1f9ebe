"""What more cores and machines would give, from costs that are measured on one core here.

    python -m benchmarks.forecast experiment=quickstart worlds=8192,65536

It trains with 64, 256 and 1024 worlds on one core and fits two straight lines: the time of a
control step of a group, and of a minibatch, each a constant and a slope over its worlds or samples.
A forecast divides the slopes by the cores, keeps the constants, and adds the waits for the network.
Docs: ``docs/reference/scaling.md``. Other words are overrides of ``recipes.train``.
"""

import os
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

SIZES, ROUNDS = (64, 256, 1024), 5
# Waits for a sum over ranks, besides one in each minibatch and one in each pass: for the reward and
# two normalisers; and of the loop two for metrics, one for a check of weights, one for the end.
AFTER = 7
MANY = 2**18  # rows by which it is measured what every rank draws for all worlds
STEP = 1e-4  # of a sum between two processes of one machine [s]; measured: a quarter of 0.4 ms
ONE_WAY, RATE = 5e-5, 1e9  # of a network within a room [s], [bytes/s]
MACHINES = (  # machines, ranks on each, cores of a rank
    *((1, 1, 2), (1, 2, 1), (1, 1, 64), (1, 8, 8), (1, 64, 1)),
    *((8, 1, 64), (8, 8, 8), (8, 64, 1)),
)


@dataclass(frozen=True)
class Costs:
    """Of one core: a control step of a group, a minibatch, and what they grow by [s].

    ``drawn``: what every rank of several does for each sample of all: noise of the actions, the
    order of samples and which are its own.
    """

    step: float
    world: float
    minibatch: float
    sample: float
    drawn: float
    parameters: int


@dataclass(frozen=True)
class Update:
    """Its parts [s]."""

    collecting: float
    learning: float
    waiting: float

    @property
    def seconds(self) -> float:
        """All of it."""
        return self.collecting + self.learning + self.waiting


def measured(overrides: Sequence[str]) -> tuple[Costs, Any]:
    """Costs on the first usable core, and the config they are of."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    import torch

    from zfall.configs import compose_config
    from zfall.training.learner import Learner

    torch.set_num_threads(1)
    steps, minibatches = [], []
    for worlds in SIZES:
        cfg = compose_config([*overrides, f"num_envs={worlds}", "groups=1"])
        learner = Learner(cfg)
        learner.learn(learner.collect())
        collecting, learning = [], []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            data = learner.collect()
            collected = time.perf_counter()
            learner.learn(data)
            collecting.append((collected - began) / cfg.rollout_steps)
            learning.append((time.perf_counter() - collected) / (cfg.epochs * cfg.minibatches))
        steps.append(statistics.median(collecting))
        minibatches.append(statistics.median(learning))
    world, step = np.polyfit(SIZES, steps, 1, w=1 / np.array(steps))  # equal relative errors
    samples = [worlds * cfg.rollout_steps / cfg.minibatches for worlds in SIZES]
    sample, minibatch = np.polyfit(samples, minibatches, 1, w=1 / np.array(minibatches))
    parameters = sum(each.numel() for each in learner.parameters)
    return Costs(
        step,
        world,
        minibatch,
        sample,
        drawn(learner.carrier["action"].shape[-1], cfg.epochs),
        parameters,
    ), cfg


def drawn(numbers: int, epochs: int) -> float:
    """What drawing for all takes for a sample [s]: ``numbers`` of noise, its place in a pass."""
    import torch

    began = time.perf_counter()
    torch.randn(MANY, numbers)
    noise = time.perf_counter() - began
    began = time.perf_counter()
    chosen = torch.randperm(MANY)
    ((chosen >= 0) & (chosen < MANY // 2)).nonzero()
    return (noise + epochs * (time.perf_counter() - began)) / MANY


def forecast(costs: Costs, cfg: Any, worlds: int, layout: tuple[int, int, int]) -> Update:
    """An update of so many ``worlds`` on ``layout``: machines, ranks on each, cores of a rank."""
    machines, there, cores = layout
    ranks, many = machines * there, cfg.epochs * cfg.minibatches
    physics = costs.world * worlds / (ranks * cores)
    # Two groups hide the Python of one behind the physics of the other; one core has nothing to.
    step = max(physics, 2 * costs.step) if cores > 1 else physics + costs.step
    share = worlds * cfg.rollout_steps / cfg.minibatches / (ranks * cores)
    learning = many * (costs.minibatch + costs.sample * share)
    waiting = 0.0
    if ranks > 1:
        hop = STEP + (ONE_WAY if machines > 1 else 0.0)
        waits = many + cfg.epochs + AFTER
        # gloo's ring has 2 (R - 1) steps, and each is asked for and sent.
        sent = 2 * (ranks - 1) / ranks * 4 * costs.parameters * many
        waiting = waits * 4 * (ranks - 1) * hop + sent / RATE
        learning += costs.drawn * worlds * cfg.rollout_steps
    return Update(cfg.rollout_steps * step, learning, waiting)


def main(words: Sequence[str]) -> None:
    """Measures, and prints costs and forecasts."""
    own = dict(word.split("=", 1) for word in words if word.startswith("worlds="))
    overrides = [word for word in words if not word.startswith("worlds=")]
    costs, cfg = measured(overrides or ["experiment=quickstart"])
    print(f"a control step: {costs.step * 1e3:.1f} ms and {costs.world * 1e6:.0f} us a world")
    print(f"a minibatch: {costs.minibatch * 1e3:.1f} ms and {costs.sample * 1e6:.1f} us a sample")
    for worlds in map(int, own.get("worlds", "8192").split(",")):
        print(
            f"{worlds} worlds\n{'machines':>8} {'ranks':>5} {'cores':>5} {'collecting':>10} ",
            end="",
        )
        print(f"{'learning':>8} {'waiting':>7}  {'steps/s':>8} {'of all cores':>12}")
        for layout in MACHINES:
            print(row(costs, cfg, worlds, layout))


def row(costs: Costs, cfg: Any, worlds: int, layout: tuple[int, int, int]) -> str:
    """A forecast as a line; the last column is the speed by that of as many single cores."""
    update, alone = (forecast(costs, cfg, worlds, each) for each in (layout, (1, 1, 1)))
    machines, there, each = layout
    cores = machines * there * each
    parts = f"{update.collecting:10.3f} {update.learning:8.3f} {update.waiting:7.3f}"
    speed = worlds * cfg.rollout_steps / update.seconds
    share = alone.seconds / update.seconds / cores
    return f"{machines:8d} {machines * there:5d} {cores:5d} {parts}  {speed:8.0f} {share:12.2f}"


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    main(sys.argv[1:])
