"""How many cores this process may use."""

import os
import sys

_granted: int | None = None  # by whoever shares out the machine


def usable_cores() -> int:
    """Cores that this process may run on; where the system does not say, all of the machine.

    Linux knows which cores a process is bound to. macOS and Windows have no such call.
    """
    if _granted is not None:
        return _granted
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_cores(count: int) -> None:
    """Has physics and torch use so many cores, as others share the machine."""
    global _granted
    _granted = count
    os.environ["OMP_NUM_THREADS"] = str(count)  # torch reads it when it is imported
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(count)
