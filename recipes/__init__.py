"""Programs started from the shell.

zfall comes first: it picks an OpenGL before TorchRL imports MuJoCo, and says how torch's threads
wait before torch is loaded. Ctrl-c ends a program with one line while it still imports, too.
"""

import sys
from types import TracebackType


def _stopped(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt):
        print("stopped", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _stopped

import zfall  # noqa: E402, F401
