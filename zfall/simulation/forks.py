"""What has threads, in a process that is forked.

A forked process, a worker of TorchRL's ``ParallelEnv`` for instance, has none of the threads of its
parent, and would wait for them for ever when it frees what they belong to.
"""

import ctypes
import os
from typing import Any, Protocol
from weakref import WeakSet

import torch


class Threaded(Protocol):
    """What has threads."""

    def begin_again(self) -> list[Any]:
        """Gives itself new threads; returns what must not be freed in this process."""
        ...


_THREADED: WeakSet[Any] = WeakSet()


def begin_again_in_forks(threaded: Threaded) -> None:
    """Lets ``threaded`` begin again in each process that is forked from this one."""
    _THREADED.add(threaded)


def _begin_again() -> None:
    torch.set_num_threads(1)  # its own threads are gone as well, and it would wait for them
    for threaded in list(_THREADED):
        for lost in threaded.begin_again():
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(lost))


os.register_at_fork(after_in_child=_begin_again)
