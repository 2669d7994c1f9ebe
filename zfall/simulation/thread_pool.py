"""The threads that step the physics, in a process that may be forked."""

import ctypes
import os
from typing import Any
from weakref import WeakSet

from mujoco import rollout


class ThreadPool:
    """The threads of ``mujoco.rollout``, begun with the first step.

    A forked process, a worker of TorchRL's ``ParallelEnv`` for instance, has none of them, and
    would abort when it frees what it has of the pool. There, this one begins anew.

    Args:
        threads: how many.
    """

    def __init__(self, threads: int):
        self.threads, self._pool = threads, None
        _POOLS.add(self)

    _pool: rollout.Rollout | None

    def rollout(self, *args: Any, **kwargs: Any) -> None:
        """Steps worlds; see ``mujoco.rollout.Rollout.rollout``."""
        if self._pool is None:
            self._pool = rollout.Rollout(nthread=self.threads)
        self._pool.rollout(*args, **kwargs)


_POOLS: WeakSet[ThreadPool] = WeakSet()


def _leave_to_the_parent() -> None:
    for pool in list(_POOLS):
        if pool._pool is not None:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(pool._pool))  # never freed here
            pool._pool = None


os.register_at_fork(after_in_child=_leave_to_the_parent)
