"""Processes that are forked from one that has stepped."""

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from zfall.envs.humanoid import HumanoidEnv

ROOT = Path(__file__).parents[2]


def stepped() -> tuple[HumanoidEnv, torch.Tensor]:
    env = HumanoidEnv(num_envs=2, control_dt=0.04, threads=2)
    td = env.reset().set("target", env.stand_position.repeat(2, 1))
    return env, env.step(td)["next", "joint_position"]


def in_a_fork(work) -> int:
    """Exit status of a process that does some work, 0 if it is done."""
    child = os.fork()
    if child == 0:
        signal.alarm(30)  # in place of waiting for threads that are not there
        os._exit(0 if work() else 1)
    return os.waitpid(child, 0)[1]


def fork_what_has_stepped() -> None:
    """Run in a process of its own: threads of torch that others have begun do not survive forks."""
    gc.collect()
    gc.disable()
    lost, _ = stepped()
    lost.itself = [lost]  # garbage that only the collector finds
    del lost
    assert in_a_fork(lambda: gc.collect() or True) == 0
    gc.enable()
    env, expected = stepped()

    def same() -> bool:
        td = env.reset().set("target", env.stand_position.repeat(2, 1))
        return torch.equal(env.step(td)["next", "joint_position"], expected)

    assert in_a_fork(same) == 0
    assert same()


def fork_worlds_with_models_of_their_own() -> None:
    """Torch's threads have worked before, and would share the work on so many worlds."""
    env = HumanoidEnv(num_envs=512, control_dt=0.04, threads=2)
    masses = np.broadcast_to(env.simulation.field("body_mass"), (512, env.simulation.model.nbody))
    env.simulation.set_fields(torch.ones(512, dtype=torch.bool), {"body_mass": 1.1 * masses})
    assert torch.ones(1_000_000).sum() == 1_000_000
    assert in_a_fork(lambda: True) == 0


@pytest.mark.long
def test_a_fork_of_worlds_with_models_of_their_own_does_not_wait_for_ever():
    """A film's encoder starts as such a process. An alarm ends one that waits."""
    command = (
        "import os, signal; os.register_at_fork(after_in_child=lambda: signal.alarm(30));"
        f"from {__name__} import fork_worlds_with_models_of_their_own as work; work()"
    )
    alone = {**os.environ, "OMP_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", command], env=alone, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_a_forked_process_frees_and_steps_what_it_inherits():
    command = f"from {__name__} import fork_what_has_stepped as work; work()"
    alone = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", command], env=alone, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
