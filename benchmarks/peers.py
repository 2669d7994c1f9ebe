"""What others would use for the same robot and the same work, measured by ``recipes.bench``.

Every peer takes the same number of physics steps of the same MJCF per control step, with the
same actions around the standing pose, and starts anew when the robot falls. gymnasium's and the
dm_control face's do the whole task of ``push_recovery``; TorchRL's does the simplest one.
"""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import mujoco
import torch
from gymnasium.vector import AsyncVectorEnv
from hydra.utils import instantiate
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import DMControlWrapper, EnvBase, ParallelEnv
from torchrl.envs.custom.mujoco import MujocoEnv as TorchrlMujocoEnv

from benchmarks.gymnasium_peer import SCALE, SUBSTEPS, GymnasiumPeer
from zfall.configs import compose_config
from zfall.cores import usable_cores
from zfall.envs.dm_task import load
from zfall.robots import ZEROTH01

FALLEN = 0.18  # height of the base [m]
MANY = 8  # workers, where cores may be too few to hide the waiting

Array = NDArray[Any]


def measure_peers(
    actions: Tensor, seconds: float, report: Callable[[str], None] = lambda name: None
) -> dict[str, float]:
    """Control steps/s of every peer, ``peer/NAME``, with the number of workers that suits it.

    Args:
        actions: what a policy did ``(T, N, J)``; worker i repeats column i.
        seconds: of measurement for each number of workers.
        report: is called with the name before each peer starts.
    """
    cores = usable_cores()
    peers = {
        "parallel_env_dm_control": run_parallel_env_dm_control,
        "torchrl_mujoco_env": run_torchrl_mujoco_env,
        "gymnasium_async": run_gymnasium_async,
    }
    speeds = {}
    for name, run in peers.items():
        report(f"peer/{name}")
        counts = sorted({cores, min(MANY, actions.shape[1])})
        speeds[f"peer/{name}"] = max(run(actions[:, :n], seconds) for n in counts)
    return speeds


def memory_per_world(few: int = 256, many: int = 1024) -> float:
    """What one more world takes in env and step [KiB], by the peaks of two processes."""
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, spawned) as one, ProcessPoolExecutor(1, spawned) as other:
        low, high = (
            pool.submit(peak_memory, n).result() for pool, n in ((one, few), (other, many))
        )
    return (high - low) / (many - few)


def peak_memory(num_envs: int) -> int:
    """Largest memory of this process in some steps of the quickstart's env [KiB]."""
    env = instantiate(compose_config([f"num_envs={num_envs}"]).env)
    td = env.reset()
    for _ in range(8):
        _, td = env.step_and_maybe_reset(env.rand_action(td))
    # Not getrusage's, which a process inherits from the one that started it.
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0])


def run_parallel_env_dm_control(actions: Tensor, seconds: float) -> float:
    """TorchRL's ``ParallelEnv`` over the dm_control face, a process per world."""
    return _run_torchrl(ParallelEnv(actions.shape[1], dm_control_env), actions, seconds)


def run_torchrl_mujoco_env(actions: Tensor, seconds: float) -> float:
    """TorchRL's own ``MujocoEnv``, whose C backend is a process per world too."""
    env = TorchrlPeer.make(num_workers=actions.shape[1])
    return _run_torchrl(env, actions, seconds)


def run_gymnasium_async(actions: Tensor, seconds: float) -> float:
    """gymnasium's ``AsyncVectorEnv`` over its own ``MujocoEnv``, see ``GymnasiumPeer``."""
    env = AsyncVectorEnv([GymnasiumPeer] * actions.shape[1], context="spawn")
    env.reset(seed=0)
    table = actions.numpy()
    try:
        return _speed(lambda step: env.step(table[step % len(table)]), actions.shape[1], seconds)
    finally:
        env.close()


def dm_control_env() -> EnvBase:
    """The dm_control face as TorchRL wraps it."""
    torch.set_num_threads(1)  # a process per core leaves no core for more
    return DMControlWrapper(load("push_recovery"))


class TorchrlPeer(TorchrlMujocoEnv):
    """The robot as a ``MujocoEnv`` of TorchRL, with the simplest of tasks."""

    @classmethod
    def make(cls, num_workers: int) -> EnvBase:
        """One world per worker."""
        return cls(
            xml_path=ZEROTH01.mjcf,
            patch_xml=False,
            backend="mujoco",
            frame_skip=SUBSTEPS,
            num_workers=num_workers,
        )

    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs)
        self._stand, reference = stand_pose(self._backend.mj_model)
        self._reference = torch.from_numpy(reference).float()

    def _sample_initial_state(
        self, n: int, tensordict: TensorDictBase | None = None
    ) -> tuple[Tensor, Tensor]:
        qpos = torch.from_numpy(self._stand).float().repeat(n, 1)
        return qpos, torch.zeros(n, self._backend.nv)

    def _prepare_ctrl(self, action: Tensor) -> Tensor:
        return self._reference + SCALE * action

    def _compute_reward(
        self, state: TensorDictBase, action: Tensor, next_state: TensorDictBase
    ) -> Tensor:
        return next_state["qpos"][:, 2:3]

    def _compute_done(self, state: TensorDictBase, next_state: TensorDictBase) -> Tensor:
        return next_state["qpos"][:, 2:3] < FALLEN


def stand_pose(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Positions ``(nq,)`` of the keyframe ``stand``, and its angle of each actuator ``(nu,)``."""
    qpos = model.key("stand").qpos.copy()
    return qpos, qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]]


def _run_torchrl(env: EnvBase, actions: Tensor, seconds: float) -> float:
    try:
        td = env.reset()
        table = actions.reshape(len(actions), *env.full_action_spec["action"].shape)

        def step(index: int) -> None:
            nonlocal td
            td["action"] = table[index % len(table)]
            td = env.step_and_maybe_reset(td)[1]

        return _speed(step, actions.shape[1], seconds)
    finally:
        env.close()


def _speed(step: Callable[[int], Any], worlds: int, seconds: float, warm_up: int = 10) -> float:
    """Control steps/s of all worlds."""
    for index in range(warm_up):
        step(index)
    done, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        step(done)
        done += 1
    return worlds * done / (time.perf_counter() - began)
