"""The gymnasium face: ``gymnasium.make("zfall/PushRecovery-v0")``, ``gymnasium.make_vec(...)``.

``import zfall`` registers the names. One world or many, it is the TorchRL env that steps.
"""

from collections.abc import Collection
from numbers import Integral
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch.nn.parameter import is_lazy
from torchrl.envs import TransformedEnv, step_mdp

from zfall.envs.tasks import ACTION_LIMIT, Table, action_bounds, build_task

Array = NDArray[Any]
Info = dict[str, Any]
INFO = ("reward_terms", "terminations")  # of the step's keys, if the table has them


class TaskEnv(gymnasium.Env[Array, Array]):
    """A task in one world.

    The observation is the table's ``observation`` ``(D,)`` float32, the action that of the
    TorchRL env ``(J,)``. ``info`` holds ``reward_terms`` and ``terminations`` of the step.

    Args:
        task: name of a table of ``recipes/env``, or a table.
        training: whether to keep what the table calls ``training_only``: pushes, noise, delays.
        overrides: values to change in a table named, written as for ``recipes.train``.
        action_limit: bound of actions that have none, see
            ``zfall.envs.tasks.ACTION_LIMIT``. It is the bound of the action space and not enforced.
        render_mode: ``rgb_array`` or nothing.

    Raises:
        ValueError: on an unknown name, overrides to a table that is no name, or a bad limit.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        task: str | Table = "push_recovery",
        *,
        training: bool = True,
        overrides: Collection[str] = (),
        action_limit: float = ACTION_LIMIT,
        render_mode: str | None = None,
    ):
        self.torchrl_env = build_task(task, num_envs=1, training=training, overrides=overrides)
        self.observation_space, self.action_space = _spaces(self.torchrl_env, action_limit)
        fps = round(1 / self.torchrl_env.base_env.control_dt)
        self.metadata = type(self).metadata | {"render_fps": fps}
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be rgb_array or None, got {render_mode!r}.")
        self.render_mode = render_mode
        self._renderer: mujoco.Renderer | None = None
        self._seeded, self._fresh = False, _buffers(self.torchrl_env)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, Info]:
        """Begins an episode; without a seed it goes on from the last one's random stream."""
        _refuse(options)
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            _seed(self.torchrl_env, self.np_random)
            # Levels of curricula, too; what is made at the first reset is not among it.
            self.torchrl_env.transform.load_state_dict(self._fresh, strict=False)
            self._seeded = True
        self._td = self.torchrl_env.reset()
        return _array(self._td["observation"][0]), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, Info]:
        """Takes one control step."""
        self._td["action"] = _tensor(action, self.action_space)[None]
        data = self.torchrl_env.step(self._td)
        self._td, after = step_mdp(data), data["next"]
        info = {
            key: {name: value.item() for name, value in after[key].items()}
            for key in INFO
            if key in after.keys()
        }
        flags = (bool(after["terminated"]), bool(after["truncated"]))
        return _array(after["observation"][0]), after["reward"].item(), *flags, info

    def render(self) -> Any:
        """The robot as the camera ``track`` sees it ``(480, 640, 3)``, in mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        simulation = self.torchrl_env.base_env.simulation
        if self._renderer is None:
            self._renderer = mujoco.Renderer(simulation.model, 480, 640)
            self._data = mujoco.MjData(simulation.model)
        self._data.qpos[:] = simulation.qpos[0]
        mujoco.mj_forward(simulation.model, self._data)
        self._renderer.update_scene(self._data, camera="track")
        return self._renderer.render()

    def close(self) -> None:
        """Frees the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class TaskVectorEnv(VectorEnv[Array, Array, Array]):
    """A task in many worlds, stepped together; arguments as ``TaskEnv``.

    Worlds that end begin anew in the same step: what they ended with is in ``final_obs`` and
    ``final_info``, in gymnasium's mode ``SAME_STEP``. One seed is for all worlds: they share a
    random stream.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}

    def __init__(
        self,
        task: str | Table = "push_recovery",
        *,
        num_envs: int,
        training: bool = True,
        overrides: Collection[str] = (),
        action_limit: float = ACTION_LIMIT,
    ):
        self.num_envs = num_envs
        self.torchrl_env = build_task(
            task, num_envs=num_envs, training=training, overrides=overrides
        )
        spaces = _spaces(self.torchrl_env, action_limit)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(s, num_envs) for s in spaces)
        self._seeded, self._fresh = False, _buffers(self.torchrl_env)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, Info]:
        """Begins an episode in every world."""
        _refuse(options)
        if seed is not None and not isinstance(seed, Integral):
            raise ValueError(f"seed must be one number for all worlds, got {seed}.")
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            _seed(self.torchrl_env, self.np_random)
            self.torchrl_env.transform.load_state_dict(self._fresh, strict=False)
            self._seeded = True
        self._td = self.torchrl_env.reset()
        return _array(self._td["observation"]), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, Info]:
        """Takes one control step in every world."""
        self._td["action"] = _tensor(actions, self.action_space)
        data, self._td = self.torchrl_env.step_and_maybe_reset(self._td)
        after = data["next"]
        terminated, truncated = (_array(after[key][:, 0]) for key in ("terminated", "truncated"))
        ended = terminated | truncated
        info = _info(after, ~ended)
        if ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            for world in np.flatnonzero(ended):
                final[world] = _array(after["observation"][world])
            info |= {"final_obs": final, "_final_obs": ended.copy()}
            info |= {"final_info": _info(after, ended), "_final_info": ended.copy()}
        reward = _array(after["reward"][:, 0].double())
        return _array(self._td["observation"]), reward, terminated, truncated, info


def _spaces(env: TransformedEnv, limit: float) -> tuple[Box, Box]:
    """Observation and action space of one world."""
    size = env.observation_spec["observation"].shape[-1]
    return Box(-np.inf, np.inf, (size,), np.float32), Box(*action_bounds(env, limit))


def _buffers(env: TransformedEnv) -> dict[str, torch.Tensor]:
    """Copies of what the transforms keep, as far as it is there."""
    kept = env.transform.named_buffers()
    return {key: value.clone() for key, value in kept if not is_lazy(value)}


def _seed(env: TransformedEnv, generator: np.random.Generator) -> None:
    env.base_env.set_seed(int(generator.integers(2**62)))


def _refuse(options: dict[str, Any] | None) -> None:
    if options:
        raise ValueError(f"options must be empty, there are none here; got {', '.join(options)}.")


def _tensor(action: Array, space: Space[Array]) -> torch.Tensor:
    values = np.array(action, dtype=np.float32)
    if values.shape != space.shape:
        raise ValueError(f"action must have the shape {space.shape}, got {values.shape}.")
    if not np.isfinite(values).all():
        raise ValueError(f"action must be finite, got {values[~np.isfinite(values)][0]}.")
    return torch.from_numpy(values)


def _array(value: torch.Tensor) -> Array:
    return value.numpy().copy()


def _info(after: TensorDictBase, worlds: Array) -> Info:
    """``info`` of a step for some worlds, each entry with a mask ``_NAME`` of these worlds."""
    info: Info = {}
    if not worlds.any():
        return info
    for key in (key for key in INFO if key in after.keys()):
        entries: Info = {}
        for name, value in after[key].items():
            values = _array(value[:, 0].double() if value.is_floating_point() else value[:, 0])
            entries |= {name: np.where(worlds, values, values.dtype.type(0))}
            entries |= {f"_{name}": worlds.copy()}
        info |= {key: entries, f"_{key}": worlds.copy()}
    return info
