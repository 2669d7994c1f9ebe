"""How many cores this process may use."""

import os


def usable_cores() -> int:
    """Cores that this process may run on; where the system does not say, all of the machine.

    Linux knows which cores a process is bound to. macOS and Windows have no such call.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
