"""Killed at random moments and resumed: the same run, to the last bit."""

import multiprocessing
import random
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from zfall import checkpoint

KILLS = 5
UPDATES = 28
COMMON = ["num_envs=8", "rollout_steps=4", "minibatches=2", "epochs=2", f"total_frames={UPDATES * 32}", "checkpoint_every=3",
          "showcase=null", "env=push_recovery_realistic", "env.transforms.push.interval=[0.0,0.1]",
          "env.transforms.limit.seconds=0.3", "symmetry=loss", "caps=atalante"]  # fmt: skip


def train(args: list[str]) -> None:
    """``python -m recipes.train ARGS`` in a process of its own."""
    from recipes import train as recipe
    from recipes.shell import start

    torch.set_num_threads(1)  # such small batches gain nothing from more
    sys.argv = ["recipes/train.py", *args]
    start(recipe.main)


def rows(folder: Path) -> int:
    path = folder / "metrics.csv"
    return len(path.read_text().splitlines()) - 1 if path.exists() else 0


def same(left: Any, right: Any) -> bool:
    if isinstance(left, dict):
        return left.keys() == right.keys() and all(same(left[k], right[k]) for k in left)
    if isinstance(left, (list, tuple)):
        return len(left) == len(right) and all(map(same, left, right))
    return torch.equal(left, right) if isinstance(left, torch.Tensor) else left == right


@pytest.mark.parametrize(("actor", "groups"), [("mlp_gaussian", 1), ("gru_mog", 2)])
def test_a_run_killed_again_and_again_equals_the_one_left_alone(actor, groups, tmp_path):
    """With every transform, curriculum, normaliser and loss on; kill -9 at five moments."""
    # Processes begin with all imports done.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["recipes.train"])
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    own = [*COMMON, f"actor={actor}", f"groups={groups}"]
    alone = context.Process(target=train, args=([*own, f"hydra.run.dir={whole}"],))
    alone.start()
    alone.join()
    assert alone.exitcode == 0
    moments = random.Random(0)
    args = [*own, f"hydra.run.dir={parts}"]
    for kill in range(KILLS):
        process = context.Process(target=train, args=(args,))
        process.start()
        enough = (kill + 1) * UPDATES // (KILLS + 2)
        while rows(parts) < enough and process.is_alive():
            time.sleep(0.005)
        time.sleep(moments.uniform(0.0, 0.15))
        assert process.is_alive()
        process.kill()
        process.join()
        args = [f"resume={parts}", f"hydra.run.dir={tmp_path}/{kill}"]
    last = context.Process(target=train, args=(args,))
    last.start()
    last.join()
    assert last.exitcode == 0
    assert (parts / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    left, right = (checkpoint.load(folder / "checkpoints" / "last.pt") for folder in (parts, whole))
    assert left["updates"] == UPDATES
    assert same(
        {k: v for k, v in left.items() if k != "config"},
        {k: right[k] for k in left if k != "config"},
    )
