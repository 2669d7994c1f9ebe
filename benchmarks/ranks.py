"""How fast two processes of half the cores train, by one process of all of them.

    python -m benchmarks.ranks ranks=2 rounds=8 updates=5 num_envs=512
    python -m benchmarks.ranks ranks=2 rounds=4 updates=2 num_envs=512 delay_ms=10    # as root

All trainings are set up first. They then take turns, so that a machine whose speed drifts treats
them alike; those whose turn it is not sleep. With a delay, a third training is of ranks in network
namespaces between which every packet is so late; what it costs an update is set next to the model,
``waits * latency + bytes / rate``. Other words are overrides of ``recipes.train``.
"""

import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

OWN = {"ranks": 2, "rounds": 8, "updates": 5, "delay_ms": 0.0}
SMALL, LARGE, REPEATS = 8, 524_288, 20  # floats of the sums that the model is fitted to


def train_when_told(
    told: Connection,
    rank: int,
    size: int,
    folder: str,
    overrides: Sequence[str],
    namespace: str | None,
) -> None:
    """A rank, or the only process, that makes so many updates whenever it is told to.

    It sends the seconds of collecting and of learning, and control steps. Told ``"network"`` it
    sends how often an update waits for a sum, all sums' bytes, and the model's two numbers.
    """
    from benchmarks.delayed_network import DEVICE, enter
    from zfall.training.launch import STORE, share_cores

    if namespace is not None:
        enter(namespace)
        os.environ["GLOO_SOCKET_IFNAME"] = DEVICE
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
            if updates == "network":
                told.send(network_of(learner))
                continue
            collecting = learning = 0.0
            for _ in range(updates):
                began = time.perf_counter()
                data = learner.collect()
                collected = time.perf_counter()
                learner.learn(data)
                collecting += collected - began
                learning += time.perf_counter() - collected
            told.send((collecting, learning, updates * learner.frames_per_batch))


def network_of(learner: Any) -> dict[str, float]:
    """What an update sends, and how long sums over this network take."""
    import torch.distributed as dist

    from benchmarks.all_reduce import seconds_of_a_sum

    real, sent, waits = dist.all_reduce, [], []

    def counted(tensor: Any, async_op: bool = False) -> Any:
        sent.append(tensor.numel() * tensor.element_size())
        waits.append(not async_op)  # what is not waited for goes beside the next
        return real(tensor, async_op=async_op)

    dist.all_reduce = counted
    try:
        learner.learn(learner.collect())
    finally:
        dist.all_reduce = real
    medians = [seconds_of_a_sum(size, REPEATS) for size in (SMALL, LARGE)]
    rate = 4 * (LARGE - SMALL) / max(medians[1] - medians[0], 1e-9)
    return {"waits": sum(waits), "bytes": sum(sent), "latency": medians[0], "rate": rate}


def started(
    size: int, folder: str, overrides: Sequence[str], namespaces: Sequence[str] = ()
) -> list[Connection]:
    """A training in so many processes; each waits to be told."""
    context = multiprocessing.get_context("spawn")
    ours = []
    for rank in range(size):
        here, there = context.Pipe()
        place = namespaces[rank] if namespaces else None
        args = (there, rank, size, folder, overrides, place)
        context.Process(target=train_when_told, args=args, daemon=True).start()
        ours.append(here)
    return ours


def turn(training: Sequence[Connection], updates: int) -> tuple[float, float, float]:
    """A training makes so many updates: seconds of collecting, learning, and control steps.

    Ranks meet at the end of both, so the slowest one's are those of all.
    """
    for process in training:
        process.send(updates)
    said = [process.recv() for process in training]
    collecting = max(one[0] for one in said)
    return collecting, max(sum(one[:2]) for one in said) - collecting, said[0][2]


def main(words: Sequence[str]) -> dict[str, float]:
    """Measures and prints; returns control steps/s of each training and the efficiency."""
    from benchmarks.delayed_network import delayed_network

    given = dict(word.split("=", 1) for word in words)
    own: dict[str, Any] = {key: type(value)(given.get(key, value)) for key, value in OWN.items()}
    overrides = [word for word in words if word.partition("=")[0] not in OWN]
    ranks, updates = own["ranks"], own["updates"]
    with ExitStack() as stack:
        folders = [stack.enter_context(tempfile.TemporaryDirectory()) for _ in range(3)]
        trainings = {"one process": started(1, folders[0], overrides)}
        trainings[f"{ranks} ranks"] = started(ranks, folders[1], overrides)
        if own["delay_ms"]:
            places = stack.enter_context(delayed_network(ranks, own["delay_ms"]))
            late = f"{ranks} ranks, {own['delay_ms']:g} ms"
            trainings[late] = started(ranks, folders[2], overrides, places)
        turns: dict[str, list[tuple[float, float, float]]] = {name: [] for name in trainings}
        for training in trainings.values():
            turn(training, 1)  # what is compiled or made once
        for number in range(own["rounds"]):
            order = list(trainings) if number % 2 == 0 else list(trainings)[::-1]
            for name in order:
                turns[name].append(turn(trainings[name], updates))
        network = {name: asked(training) for name, training in list(trainings.items())[1:]}
        for training in trainings.values():
            for process in training:
                process.send(None)
    return report(turns, network, updates)


def asked(training: Sequence[Connection]) -> dict[str, float]:
    """What the first rank says of the network."""
    for process in training:
        process.send("network")
    said = [process.recv() for process in training]
    return said[0]


def report(
    turns: dict[str, list[tuple[float, float, float]]],
    network: dict[str, dict[str, float]],
    updates: int,
) -> dict[str, float]:
    """Prints what was measured, and what the model says of a delay."""
    found, times = {}, {}
    for name, measured in turns.items():
        collecting, learning = (
            statistics.median(one[part] / updates for one in measured) for part in (0, 1)
        )
        times[name] = statistics.median((one[0] + one[1]) / updates for one in measured)
        found[name] = statistics.median(one[2] / (one[0] + one[1]) for one in measured)
        print(
            f"{name:18s} {found[name]:6.0f} control steps/s, an update {times[name]:6.2f} s: ",
            end="",
        )
        print(f"collecting {collecting:.2f}, learning {learning:.2f}")
    one, several, *late = turns
    ratios = [
        (b[2] / (b[0] + b[1])) / (a[2] / (a[0] + a[1]))
        for a, b in zip(turns[one], turns[several], strict=True)
    ]
    found["efficiency"] = statistics.median(ratios)
    spread = f"{min(ratios):.3f} to {max(ratios):.3f}"
    print(f"efficiency         {found['efficiency']:6.3f} median, {spread}")
    for name, of in network.items():
        costs = of["waits"] * of["latency"] + of["bytes"] / of["rate"]
        print(f"{name:18s} {of['waits']} waits, {of['bytes'] / 1e6:.2f} MB in an update, ", end="")
        print(f"{of['latency'] * 1e3:.2f} ms and {of['rate'] / 1e6:.0f} MB/s: {costs:.2f} s")
        found[f"model, {name}"] = costs
    for name in late:
        measured = times[name] - times[several]
        model = found[f"model, {name}"] - found[f"model, {several}"]
        print(f"the delay costs    {measured:6.2f} s of an update, model {model:.2f} s")
        found |= {"measured": measured, "model": model}
    return found


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    main(sys.argv[1:])
