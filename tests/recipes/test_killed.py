"""Killed at random moments and resumed: the same run, to the last bit."""

import multiprocessing
import random
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from zfall import checkpoint

pytestmark = pytest.mark.long

UPDATES = 20
COMMON = ["num_envs=4", "rollout_steps=4", "minibatches=2", "epochs=2", f"total_frames={UPDATES * 16}",
          "checkpoint_every=3", "showcase=null", "logger=null"]  # fmt: skip
FREQUENT = ["env.transforms.push.interval=[0.0,0.1]", "env.transforms.limit.seconds=0.3"]
TRAININGS = {
    "mlp": ["env.transforms.limit.seconds=0.3"],
    "gru": ["actor=gru_mog", "critic=gru", "loss=icub", "groups=2", *FREQUENT],
    "kneeling": ["experiment=push_to_kneel", "env.transforms.mode.probability=0.5",
                 "env.transforms.push.size=[1.0,2.0]", *FREQUENT],
    # Every transform, the curriculum, and losses with a state.
    "realistic": ["env=push_recovery_realistic", "symmetry=loss", "caps=atalante", *FREQUENT],
}  # fmt: skip


def train(args: list[str]) -> None:
    """``python -m recipes.train ARGS`` in a process of its own."""
    from recipes import train as recipe
    from recipes.shell import start

    torch.set_num_threads(1)  # such small batches gain nothing from more
    sys.argv = ["recipes/train.py", *args]
    start(recipe.main)


def started(args: list[str]) -> Any:
    """A process that trains; it begins with all imports done."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["recipes.train", "zfall.training.begin", "zfall.evaluation.showcase"]
    )
    process = context.Process(target=train, args=(args,))
    process.start()
    return process


def updates(folder: Path) -> int:
    """How many updates its last checkpoint has behind it; 0 without one."""
    last = folder / "checkpoints" / "last.pt"
    return int(checkpoint.load(last)["updates"]) if last.exists() else 0


def same(left: Any, right: Any) -> bool:
    if isinstance(left, dict):
        return left.keys() == right.keys() and all(same(left[k], right[k]) for k in left)
    if isinstance(left, (list, tuple)):
        return len(left) == len(right) and all(map(same, left, right))
    return torch.equal(left, right) if isinstance(left, torch.Tensor) else left == right


def assert_same_run(one: Path, other: Path) -> None:
    assert (one / "metrics.csv").read_bytes() == (other / "metrics.csv").read_bytes()
    files = (folder / "checkpoints" / "last.pt" for folder in (one, other))
    left, right = (
        {
            key: value
            for key, value in checkpoint.load(file).items()
            if key not in ("config", "digest")
        }
        for file in files
    )
    assert left["updates"] == UPDATES
    assert same(left, right)


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def wait_for_moment(process: Any, metrics: Path, longest: float, moments: random.Random) -> None:
    """Somewhere in the whole life of a process, or while it learns, writes and saves."""
    if moments.random() < 0.3:
        process.join(moments.uniform(0.0, longest))
        return
    before = size(metrics)
    while process.is_alive() and size(metrics) <= before:
        time.sleep(0.001)
    process.join(moments.uniform(0.0, 0.2))


def check(kind: str, folder: Path, kills: int, seed: int) -> None:
    """Kills a training so many times; whenever it ends it must equal the one left alone."""
    own, parts, moments = [*COMMON, *TRAININGS[kind]], folder / "parts", random.Random(seed)
    began = time.monotonic()
    alone = started([*own, f"hydra.run.dir={folder}/whole"])
    alone.join()
    longest = time.monotonic() - began
    assert alone.exitcode == 0
    ended = False
    while kills or not ended:
        if updates(parts) in (0, UPDATES):
            shutil.rmtree(parts, ignore_errors=True)
            args = [*own, f"hydra.run.dir={parts}"]
        else:
            args = [f"resume={parts}", f"hydra.run.dir={folder}/unused"]
        process = started(args)
        if kills:
            wait_for_moment(process, parts / "metrics.csv", longest, moments)
        else:
            process.join()
        ended = not process.is_alive()
        if ended:
            assert process.exitcode == 0
            assert_same_run(parts, folder / "whole")
        else:
            kills -= 1
            process.kill()
            process.join()


def test_a_run_killed_at_random_moments_equals_the_one_left_alone(tmp_path):
    check("gru", tmp_path, kills=1, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRAININGS)
def test_a_run_killed_25_times_equals_the_one_left_alone(kind, tmp_path):
    """A hundred kills over the four trainings."""
    check(kind, tmp_path, kills=25, seed=1)
