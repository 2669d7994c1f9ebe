import threading
import time

import pytest
import torch

from zfall.envs.threads import in_turns, others_turn, physics_first


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


def test_a_task_that_fails_lets_the_others_end_and_is_told():
    ended = []

    def failing():
        with others_turn():
            pass
        raise ValueError("no such world")

    def other():
        for _ in range(5):
            with others_turn():
                pass
        ended.append(True)

    with pytest.raises(ValueError, match="no such world"):
        in_turns([failing, other])
    with pytest.raises(ValueError, match="no such world"):
        in_turns([other, failing])
    assert ended == [True, True]


def test_torch_has_one_thread_in_every_task():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with physics_first():
            assert in_turns([torch.get_num_threads] * 2) == [1, 1]
    finally:
        torch.set_num_threads(before)


def test_one_task_alone_needs_no_other_thread_and_no_turn():
    with others_turn():
        assert in_turns([threading.current_thread]) == [threading.current_thread()]
