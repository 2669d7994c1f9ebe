"""How fast two processes of half the cores train, by one process of all of them.

    python -m benchmarks.ranks ranks=2 rounds=8 updates=5 num_envs=512

Both trainings are set up first. They then take turns, so that a machine whose speed drifts treats
them alike; the one whose turn it is not sleeps. Other words are overrides of ``recipes.train``.
"""

import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

OWN = {"ranks": 2, "rounds": 8, "updates": 5}


def train_when_told(
    told: Connection, rank: int, size: int, folder: str, overrides: Sequence[str]
) -> None:
    """A rank, or the only process, that makes so many updates whenever it is told to."""
    from zfall.training.launch import STORE, share_cores

    if size > 1:
        os.environ |= {"RANK": str(rank), "WORLD_SIZE": str(size), STORE: f"{folder}/store"}
        os.environ |= {"LOCAL_RANK": str(rank), "LOCAL_WORLD_SIZE": str(size)}
        os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
        share_cores()
    import torch

    from zfall.configs import compose_config
    from zfall.cores import usable_cores
    from zfall.training.learner import Learner
    from zfall.training.meeting import ranks_of

    torch.set_num_threads(usable_cores())
    cfg = compose_config(["experiment=quickstart", *overrides])
    with ranks_of(cfg) as ranks:
        learner = Learner(cfg, ranks)
        while (updates := told.recv()) is not None:
            began = time.perf_counter()
            for _ in range(updates):
                learner.learn(learner.collect())
            told.send(updates * learner.frames_per_batch / (time.perf_counter() - began))


def started(size: int, folder: str, overrides: Sequence[str]) -> list[Connection]:
    """A training in so many processes; each waits to be told."""
    context = multiprocessing.get_context("spawn")
    ours = []
    for rank in range(size):
        here, there = context.Pipe()
        args = (there, rank, size, folder, overrides)
        context.Process(target=train_when_told, args=args, daemon=True).start()
        ours.append(here)
    return ours


def turn(training: Sequence[Connection], updates: int) -> float:
    """Control steps/s of a training while it makes so many updates: of its slowest process."""
    for process in training:
        process.send(updates)
    return min(process.recv() for process in training)


def main(words: Sequence[str]) -> dict[str, float]:
    """Measures and prints; returns control steps/s of both and the efficiency."""
    own = OWN | {
        key: int(value) for key, _, value in (w.partition("=") for w in words) if key in OWN
    }
    overrides = [word for word in words if word.partition("=")[0] not in OWN]
    shares: dict[str, list[float]] = {"one": [], "several": []}
    with tempfile.TemporaryDirectory() as folder:
        trainings = {
            "one": started(1, folder, overrides),
            "several": started(own["ranks"], folder, overrides),
        }
        for training in trainings.values():
            turn(training, 1)  # what is compiled or made once
        for number in range(own["rounds"]):
            order = list(trainings) if number % 2 == 0 else list(trainings)[::-1]
            for name in order:
                shares[name].append(turn(trainings[name], own["updates"]))
        for training in trainings.values():
            for process in training:
                process.send(None)
    ratios = [b / a for a, b in zip(shares["one"], shares["several"], strict=True)]
    speeds = {name: statistics.harmonic_mean(values) for name, values in shares.items()}
    found = {**speeds, "efficiency": statistics.median(ratios)}
    print(f"one process  {found['one']:8.0f} control steps/s")
    print(f"{own['ranks']} ranks      {found['several']:8.0f} control steps/s")
    least, most = min(ratios), max(ratios)
    print(f"efficiency   {found['efficiency']:8.3f} median, {least:.3f} to {most:.3f}")
    return found


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    main(sys.argv[1:])
