"""Fixtures shared by all tests: everything seeded, on the CPU, in seconds."""

import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import absl.logging
import pytest
import torch
from filelock import FileLock
from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from tests.shell import SHOW, TINY, run
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env

worker = os.environ.get("PYTEST_XDIST_WORKER")  # one of several processes: a core for each
if worker is not None and hasattr(os, "sched_setaffinity"):
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[int(worker.removeprefix("gw")) % len(cores)]})
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a script
    signal.signal(signal.SIGINT, signal.default_int_handler)
torch.set_num_threads(1)  # tensors are small here; threads that wait for each other cost more

RECIPES = Path(__file__).parents[1] / "recipes"

# Hydra closes all log handlers; that of absl, which dm_control brings, closes its stream with it,
# and must not take the one that pytest captures into.
absl.logging.get_absl_handler().python_handler.stream = sys.__stderr__


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)
    torch.set_num_threads(1)  # a checkpoint that a test before loaded may have set another number


@pytest.fixture(scope="session")
def compose_config() -> Callable[..., DictConfig]:
    """Composes a recipe's config as the shell would."""
    from hydra import compose, initialize_config_dir

    def build(*overrides: str, recipe: str = "train") -> DictConfig:
        with initialize_config_dir(str(RECIPES), version_base=None):
            return compose(recipe, overrides=list(overrides))

    return build


@pytest.fixture
def make_base() -> Callable[..., HumanoidEnv]:
    """A base env with few worlds."""

    def build(num_envs: int = 4, control_dt: float = 0.04, **kwargs: object) -> HumanoidEnv:
        return HumanoidEnv(num_envs=num_envs, control_dt=control_dt, **kwargs)

    return build


@pytest.fixture
def make_task(make_base: Callable[..., HumanoidEnv]) -> Callable[..., TransformedEnv]:
    """An env with the given transforms, each a class and its values."""

    def build(transforms: dict[str, tuple], **kwargs: object) -> TransformedEnv:
        base = make_base(**kwargs)
        built = {name: cls(base, **values) for name, (cls, values) in transforms.items()}
        return make_env(base, built)

    return build


@pytest.fixture(scope="session")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of two updates with its showcase, trained once for all processes."""
    root = tmp_path_factory.getbasetemp()
    root = root if worker is None else root.parent  # which all of them share
    folder, done = root / "one_run", root / "one_run.done"
    with FileLock(root / "one_run.lock"):
        if not done.exists():
            ran = run("train", *TINY[:-1], *SHOW, f"hydra.run.dir={folder}")
            assert ran.returncode == 0, ran.stderr
            assert "pose_hold" in ran.stdout
            done.touch()
    return folder


@pytest.fixture(scope="module")
def trained(one_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of that run, into which the tests of a file may write."""
    return Path(shutil.copytree(one_run, tmp_path_factory.mktemp("run") / "run"))
