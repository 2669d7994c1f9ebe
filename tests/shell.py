"""Recipes as from the shell, for tests."""

import importlib
import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from recipes.shell import start

ROOT = Path(__file__).parents[1]
TINY = ["num_envs=8", "rollout_steps=4", "minibatches=2", "epochs=2", "total_frames=64",
        "checkpoint_every=1", "statistics_batches=0", "showcase=null"]  # fmt: skip
SMALL = ["starts=1", "directions=2", "impulses=[0.2]", "point=pelvis", "end_time=4.0"]
SOON = {"push_time": 0.2, "end_time": 1.0}  # of a battery, in place of 3 and 7 s
SHOW = ["showcase={starts: 1, sizes: [0.4], video: false}"]


class Done(NamedTuple):
    """How a program ended."""

    returncode: int
    stdout: str
    stderr: str


def run(module: str, *args: str) -> Done:
    """``python -m recipes.MODULE ARGS`` in this process, which has imported everything."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    argv, sys.argv = sys.argv, [f"recipes/{module}.py", *args]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            start(importlib.import_module(f"recipes.{module}").main)
    except SystemExit as stop:
        code = stop.code
    finally:
        sys.argv = argv
    if isinstance(code, str):  # as the interpreter does: print it and exit with 1
        err.write(code + "\n")
        code = 1
    return Done(int(code or 0), out.getvalue(), err.getvalue())
