"""Who may use the cores while the physics runs."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


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
