"""Who may use the cores while the physics runs."""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, CancelledError, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

import torch

T = TypeVar("T")

_turns = threading.local()  # ``mine``: the turns that a thread takes part in, and its place


@contextmanager
def physics_first() -> Iterator[None]:
    """Keeps torch to one thread while worlds are stepped; what it had comes back after it.

    Torch's helper threads go on spinning for some milliseconds after each large operation, on the
    very cores that the physics is about to take.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def in_turns(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Runs tasks that take turns: the physics of one runs while Python works for another.

    Python uses one core, and the physics' threads would wait for it. Here a task hands over to the
    next one while an env of this package steps its physics. It goes on when that is done and its
    turn has come again. The order of turns does not depend on how long anything takes, so random
    numbers that the tasks share are drawn in the same order in every run.

    Each task runs in a new thread with torch's default modes: it has to switch gradients off
    itself. What holds for all threads, such as TorchRL's type of exploration, is set around the
    call, not within a task.

    Args:
        tasks: each called once, without arguments.

    Returns:
        What they returned, in their order.

    Raises:
        Exception: what a task raised; the others end where their turn would have come.
    """
    if len(tasks) == 1:
        return [tasks[0]()]
    turns = _Turns(len(tasks))

    def run(place: int) -> T:
        _turns.mine = (turns, place)
        turns.wait(place)
        try:
            return tasks[place]()
        finally:
            turns.leave(place)

    with ThreadPoolExecutor(len(tasks)) as pool:
        try:
            runs = [pool.submit(run, place) for place in range(len(tasks))]
            for done in wait(runs, return_when=FIRST_EXCEPTION).done:
                done.result()  # raises what a task raised, while others may not be over
            return [done.result() for done in runs]
        finally:  # with all of them over it changes nothing
            turns.cancel()


@contextmanager
def others_turn() -> Iterator[None]:
    """While it lasts the next of the tasks that run ``in_turns`` with the caller may go on."""
    turns, place = getattr(_turns, "mine", (None, 0))
    if turns is None:
        yield
        return
    turns.hand_over(place)
    try:
        yield
    finally:
        turns.wait(place)


class _Turns:
    """Whose turn it is among some threads; that of the first to begin with."""

    def __init__(self, count: int):
        self._going = list(range(count))
        self._calls = [threading.Semaphore(int(place == 0)) for place in range(count)]
        self._cancelled = False

    def wait(self, place: int) -> None:
        """Comes back when it is the turn of the thread in ``place``.

        Raises:
            CancelledError: if there are no more turns.
        """
        self._calls[place].acquire()
        if self._cancelled:
            raise CancelledError

    def cancel(self) -> None:
        """Ends all that wait for their turn, now or later."""
        self._cancelled = True
        for call in self._calls:
            call.release()

    def hand_over(self, place: int) -> None:
        after = self._going[(self._going.index(place) + 1) % len(self._going)]
        self._calls[after].release()

    def leave(self, place: int) -> None:
        after = self._going.index(place)
        self._going.remove(place)  # before the next one wakes up, and looks who is there
        if self._going:
            self._calls[self._going[after % len(self._going)]].release()
