import signal
import threading
import time

import pytest
import torch

from zfall.simulation.turns import _Turns, in_turns, others_turn, physics_first


def test_torch_gets_its_threads_back_even_after_an_error():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with pytest.raises(RuntimeError, match="had 1 thread"), physics_first():
            raise RuntimeError(f"had {torch.get_num_threads()} thread")
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("slow", [0, 1, 2, None])
def test_turns_follow_each_other_whoever_is_slow(slow):
    """Three tasks that step three times, once, and twice; a letter for each time in Python."""
    log = []

    def task(place, steps):
        log.append("abc"[place])
        for _ in range(steps):
            with others_turn():
                time.sleep(0.02 if place == slow else 0.0)
            log.append("abc"[place])
        return steps

    assert in_turns([lambda k=k, n=n: task(k, n) for k, n in enumerate((3, 1, 2))]) == [3, 1, 2]
    assert "".join(log) == "abc" + "abc" + "ac" + "a"


def test_the_next_one_goes_on_while_the_physics_runs_and_only_then():
    stepping, most, inside = threading.Event(), [], []

    def first():
        with others_turn():
            assert stepping.wait(10.0)  # set by the second one, which has its turn meanwhile
        busy("first")

    def second():
        stepping.set()
        busy("second")

    def busy(name):
        inside.append(name)
        most.append(len(inside))
        time.sleep(0.02)
        inside.remove(name)

    in_turns([first, second])
    assert most == [1, 1]


def failing():
    with others_turn():
        pass
    raise ValueError("no such world")


@pytest.mark.parametrize("first", [True, False])
def test_a_task_that_fails_ends_the_others_and_is_told(first):
    begun, ended = threading.Event(), []

    def endless():
        for _ in range(3000):
            begun.set()
            with others_turn():
                time.sleep(0.01)
        ended.append(True)

    tasks = [failing, endless] if first else [endless, failing]
    with pytest.raises(ValueError, match="no such world"):
        in_turns(tasks)
    assert begun.is_set()
    assert not ended


def test_an_interrupt_ends_all_at_their_next_turn():
    def endless():
        for _ in range(3000):
            with others_turn():
                time.sleep(0.01)

    main, began = threading.get_ident(), time.perf_counter()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # pytest-xdist ignores it
    try:
        threading.Timer(0.2, lambda: signal.pthread_kill(main, signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            in_turns([endless, endless])
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.perf_counter() - began < 10.0


def test_who_leaves_is_gone_before_the_next_one_looks(monkeypatch):
    """Else the next one would hand over to a thread that is not there, and wait for ever."""
    turns, seen = _Turns(3), []
    for call in turns._calls:
        monkeypatch.setattr(call, "release", lambda: seen.append(list(turns._going)))
    turns.leave(2)
    turns.leave(0)
    assert seen == [[0, 1], [1]]


def test_one_task_alone_needs_no_other_thread_and_no_turn():
    with others_turn():
        assert in_turns([threading.current_thread]) == [threading.current_thread()]
