"""How long the sums over ranks take, by their size; over loopback, or a network with a delay.

    python -m benchmarks.all_reduce ranks=2 repeats=200
    python -m benchmarks.all_reduce ranks=2 delay_ms=1        # as root, Linux: network namespaces

For each size it prints the median and what the model says. The model is the straight line through
the smallest and the largest size: ``seconds = latency + bytes / rate``. With a delay, ranks are in
network namespaces, and every packet between them is late by so much. Then the latency should be
``4 (ranks - 1)`` times the delay: gloo's ring takes 2 (ranks - 1) steps, and each is asked for
before it is sent.
"""

import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path

OWN = {"ranks": 2, "repeats": 200, "delay_ms": 0.0}
FLOATS = (1024, 16_384, 131_072, 524_288, 2_097_152)


def work(rank: int, ranks: int, repeats: int, store: str) -> None:
    """A rank: sums tensors of every size; the first prints what it took."""
    import torch
    import torch.distributed as dist

    torch.set_num_threads(1)
    meeting = dist.FileStore(store, ranks)
    wait = timedelta(seconds=60)
    dist.init_process_group("gloo", store=meeting, rank=rank, world_size=ranks, timeout=wait)
    medians = {4 * size: seconds_of_a_sum(size, repeats) for size in FLOATS}
    if rank == 0:
        report(medians)
    dist.destroy_process_group()


def seconds_of_a_sum(floats: int, repeats: int) -> float:
    """Median of so many sums over the ranks that have met [s]; all of them must call it."""
    import torch
    import torch.distributed as dist

    values, times = torch.zeros(floats), []
    for _ in range(repeats):
        dist.barrier()
        began = time.perf_counter()
        dist.all_reduce(values)
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def report(medians: dict[int, float]) -> None:
    """Prints medians [s] by bytes, and the model's."""
    (least, fastest), *_, (most, slowest) = medians.items()
    rate = (most - least) / max(slowest - fastest, 1e-12)
    latency = fastest - least / rate
    print(f"latency {latency * 1e6:.0f} us, rate {rate / 1e6:.0f} MB/s")
    print("    bytes   measured [us]   model [us]")
    for size, seconds in medians.items():
        print(f"{size:9d} {seconds * 1e6:15.0f} {(latency + size / rate) * 1e6:12.0f}")


def main(words: Sequence[str]) -> None:
    """Starts the ranks and waits for them."""
    from benchmarks.delayed_network import DEVICE, delayed_network

    given = dict(word.split("=", 1) for word in words)
    own = {key: type(value)(given.get(key, value)) for key, value in OWN.items()}
    ranks = int(own["ranks"])
    with ExitStack() as stack:
        names = None
        if own["delay_ms"]:
            names = stack.enter_context(delayed_network(ranks, own["delay_ms"]))
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        processes = []
        for rank in range(ranks):
            me = [sys.executable, "-m", "benchmarks.all_reduce", f"rank={rank}"]
            me += [f"ranks={ranks}", f"repeats={int(own['repeats'])}", f"store={folder}/store"]
            before = ["ip", "netns", "exec", names[rank]] if names else []
            interface = DEVICE if names else _loopback()
            env = {**os.environ, "GLOO_SOCKET_IFNAME": interface}
            processes.append(subprocess.Popen([*before, *me], env=env))
        codes = [process.wait() for process in processes]
        if any(codes):
            raise SystemExit(1)


def _loopback() -> str:
    return next(name for _, name in socket.if_nameindex() if name.startswith("lo"))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    arguments = dict(word.split("=", 1) for word in sys.argv[1:])
    if "rank" in arguments:
        numbers = (int(arguments[key]) for key in ("rank", "ranks", "repeats"))
        work(*numbers, store=arguments["store"])
    else:
        main(sys.argv[1:])
