"""Ranks far apart: the network that is late, and what is forecast of many of them."""

import multiprocessing
import socket
import time
from types import SimpleNamespace

import pytest

from benchmarks.delayed_network import NET, delayed_network, enter
from benchmarks.forecast import Costs, forecast


def namespaces_work() -> bool:
    try:
        with delayed_network(1, delay_ms=0):
            return True
    except (SystemExit, OSError):
        return False


needs_namespaces = pytest.mark.skipif(
    not namespaces_work(), reason="the system refuses network namespaces or tun devices"
)
ASKED = 5
CFG = SimpleNamespace(rollout_steps=8, epochs=2, minibatches=5)
COSTS = Costs(
    step=0.01, world=0.001, minibatch=0.02, sample=0.0001, drawn=1e-6, parameters=1_000_000
)


@needs_namespaces
def test_a_packet_and_its_answer_take_two_delays():
    context = multiprocessing.get_context("spawn")
    with delayed_network(2, delay_ms=30) as (here, there):
        ready, took = context.Event(), context.Queue()
        answering = context.Process(target=answer, args=(there, ready))
        asking = context.Process(target=ask, args=(here, ready, took))
        answering.start()
        asking.start()
        seconds = [took.get(timeout=60) for _ in range(ASKED)]
        for process in (asking, answering):
            process.join(10)
    assert 0.060 <= min(seconds) < 0.090  # a busy machine is late, not always


def answer(namespace, ready):
    enter(namespace)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind((f"{NET}.2", 5005))
        ready.set()
        for _ in range(ASKED):
            packet, sender = end.recvfrom(10)
            end.sendto(packet, sender)


def ask(namespace, ready, took):
    enter(namespace)
    ready.wait(60)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        for _ in range(ASKED):
            began = time.monotonic()
            end.sendto(b"?", (f"{NET}.2", 5005))
            end.recv(10)
            took.put(time.monotonic() - began)


def test_an_update_of_one_core_is_its_steps_and_its_minibatches():
    update = forecast(COSTS, CFG, worlds=100, layout=(1, 1, 1))
    assert update.collecting == pytest.approx(8 * (0.01 + 100 * 0.001))
    assert update.learning == pytest.approx(10 * (0.02 + 160 * 0.0001))  # 100 * 8 / 5 samples
    assert update.waiting == 0


@pytest.mark.parametrize(("worlds", "step"), [(60, 0.02), (1000, 0.25)])
def test_with_more_cores_the_longer_of_physics_and_python_counts(worlds, step):
    """Four cores: 15 or 250 ms of physics in a step, and 10 ms of Python for each of two groups."""
    assert forecast(COSTS, CFG, worlds, (1, 1, 4)).collecting == pytest.approx(8 * step)


def test_ranks_wait_for_a_ring_in_each_minibatch():
    """19 waits of 4 (R - 1) steps of 0.1 ms, and ten gradients of 4 MB, 1.5 times each."""
    waiting = forecast(COSTS, CFG, worlds=100, layout=(1, 4, 1)).waiting
    assert waiting == pytest.approx(19 * 4 * 3 * 1e-4 + 10 * 4e6 * 1.5 / 1e9)
    apart = forecast(COSTS, CFG, worlds=100, layout=(4, 1, 1)).waiting
    assert apart - waiting == pytest.approx(19 * 4 * 3 * 5e-5)


def test_every_rank_draws_for_all_worlds():
    """Four cores as four ranks: a quarter of the samples, and 800 us for the draws of 800."""
    update = forecast(COSTS, CFG, worlds=100, layout=(1, 4, 1))
    assert update.learning == pytest.approx(10 * (0.02 + 40 * 0.0001) + 800e-6)
