"""``python -m zfall.with_parent MODULE ARGS``: a program that ends with whoever holds its input.

However that ends: the system then closes the pipe. The program is interrupted, as by ctrl-c, so
that what it has begun elsewhere ends as well.
"""

import os
import runpy
import signal
import sys
import threading
import time

LONGEST = 60.0  # seconds that it may take to end


def main() -> None:
    """Runs the module as ``python -m`` does."""
    threading.Thread(target=_follow, daemon=True).start()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def _follow() -> None:
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(LONGEST)
    os._exit(1)


if __name__ == "__main__":
    main()
