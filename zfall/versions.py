"""Which code made a result."""

import subprocess
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("zfall", "torch", "torchrl", "tensordict", "mujoco", "numpy")


def package_versions() -> dict[str, str]:
    """Versions of the packages that a run's bits depend on, by name."""
    return {name: version(name) for name in PACKAGES}


@cache
def versions() -> dict[str, str]:
    """Versions of the packages; of a clone also its ``commit``, ``-dirty`` if files differ."""
    found = package_versions()
    with suppress(OSError, subprocess.SubprocessError):
        _git("ls-files", "--error-unmatch", __file__)  # else another repository is around us
        found["commit"] = _git("describe", "--always", "--dirty", "--exclude=*").strip()
    return found


def _git(*arguments: str) -> str:
    """What git prints; raises if it fails."""
    done = subprocess.run(
        ["git", *arguments],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
        timeout=10,
    )
    return done.stdout
