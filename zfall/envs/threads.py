"""Who may use the cores while the physics runs."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def physics_first() -> Iterator[None]:
    """Keeps torch to one thread while worlds are stepped; what it had comes back after it.

    Torch's helper threads go on spinning for some milliseconds after each large operation, on the
    very cores that the physics is about to take. What there is by now is kept out of the rounds of
    the garbage collector, which would visit all of it again and again.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    freezes = gc.get_freeze_count() == 0  # else it was done for longer, by somebody else
    if freezes:
        gc.freeze()
    try:
        yield
    finally:
        if freezes:
            gc.unfreeze()
        torch.set_num_threads(threads)
