"""Which code made a result."""

import subprocess
from functools import cache
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("zfall", "torch", "torchrl", "tensordict", "mujoco", "numpy")


@cache
def versions() -> dict[str, str]:
    """Versions of the packages; of a clone also its ``commit``, ``-dirty`` if files differ."""
    found = {name: version(name) for name in PACKAGES}
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return found
    return found | ({"commit": done.stdout.strip()} if done.returncode == 0 else {})
