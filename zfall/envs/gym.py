"""The gymnasium face: ``gymnasium.make("zfall/PushRecovery-v0")``, ``gymnasium.make_vec(...)``.

``import zfall`` registers the names. One world or many, it is the TorchRL env that steps.
"""

from collections.abc import Collection
from numbers import Integral
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch.nn.parameter import is_lazy
from torchrl.envs import TransformedEnv, step_mdp

from zfall.envs.tasks import Table, action_bounds, build_task

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
        render_mode: ``rgb_array`` or nothing.

    Raises:
        ValueError: on an unknown name, overrides to a table that is no name, or another mode.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        task: str | Table = "push_recovery",
        *,
        training: bool = True,
        overrides: Collection[str] = (),
        render_mode: str | None = None,
    ):
        self.torchrl_env = build_task(task, num_envs=1, training=training, overrides=overrides)
        self.observation_space, self.action_space = _spaces(self.torchrl_env)
        self.metadata = type(self).metadata | {"render_fps": _frame_rate(self.torchrl_env)}
        self.render_mode = _known_mode(render_mode)
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
        return None if self.render_mode is None else self.torchrl_env.base_env.render()[0]

    def close(self) -> None:
        """Frees the renderer."""
        self.torchrl_env.base_env.camera.close()


class TaskVectorEnv(VectorEnv[Array, Array, Array]):
    """A task in many worlds, stepped together; arguments as ``TaskEnv``.

    ``autoreset_mode`` says when worlds that end begin anew, as gymnasium defines it:

    - ``SAME_STEP``: in that step; what they ended with is in ``final_obs`` and ``final_info``.
    - ``NEXT_STEP``: in the step after it, which takes no notice of their action.
    - ``DISABLED``: when ``reset(options={"reset_mask": mask})`` names them ``(N,)`` bool.

    One seed is for all worlds: they share a random stream.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": ["rgb_array"]}

    def __init__(
        self,
        task: str | Table = "push_recovery",
        *,
        num_envs: int,
        training: bool = True,
        overrides: Collection[str] = (),
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
    ):
        self.autoreset_mode, self.render_mode = (
            _known_reset(autoreset_mode),
            _known_mode(render_mode),
        )
        self.num_envs = num_envs
        self.torchrl_env = build_task(
            task, num_envs=num_envs, training=training, overrides=overrides
        )
        spaces = _spaces(self.torchrl_env)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(s, num_envs) for s in spaces)
        self.metadata = type(self).metadata | {
            "autoreset_mode": self.autoreset_mode,
            "render_fps": _frame_rate(self.torchrl_env),
        }
        self._seeded, self._fresh = False, _buffers(self.torchrl_env)
        self._ended = np.zeros(num_envs, dtype=bool)  # in the last step

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, Info]:
        """Begins an episode in every world, or in those of ``options["reset_mask"]``."""
        mask = self._masked(dict(options or {}))
        if seed is not None and not isinstance(seed, Integral):
            raise ValueError(f"seed must be one number for all worlds, got {seed}.")
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            _seed(self.torchrl_env, self.np_random)
            self.torchrl_env.transform.load_state_dict(self._fresh, strict=False)
            self._seeded = True
        if mask is None:
            self._td = self.torchrl_env.reset()
        else:
            self._begin(mask)
        self._ended = np.zeros_like(self._ended)
        return _array(self._td["observation"]), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, Info]:
        """Takes one control step in every world."""
        self._td["action"] = _tensor(actions, self.action_space)
        if self.autoreset_mode is AutoresetMode.DISABLED:
            data = self.torchrl_env.step(self._td)
            self._td = step_mdp(data)
        else:
            data, self._td = self.torchrl_env.step_and_maybe_reset(self._td)
        after = data["next"]
        terminated, truncated = (_array(after[key][:, 0]) for key in ("terminated", "truncated"))
        reward = _array(after["reward"][:, 0].double())
        began = np.zeros_like(self._ended)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._ended.any():
            # All worlds step together: these have been reset for a step that does not count.
            began = self._ended
            self._begin(began)
            terminated, truncated = terminated & ~began, truncated & ~began
            reward[began] = 0.0
        ended = self._ended = terminated | truncated
        observation = _array(self._td["observation"])
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            observation[ended] = _array(after["observation"])[ended]
            return observation, reward, terminated, truncated, _info(after, ~began)
        info = _info(after, ~ended)
        if ended.any():
            final = np.full(self.num_envs, None, dtype=object)
            for world in np.flatnonzero(ended):
                final[world] = _array(after["observation"][world])
            info |= {"final_obs": final, "_final_obs": ended.copy()}
            info |= {"final_info": _info(after, ended), "_final_info": ended.copy()}
        return observation, reward, terminated, truncated, info

    def render(self) -> Any:
        """A picture of each world ``(480, 640, 3)``, in mode ``rgb_array``."""
        return None if self.render_mode is None else tuple(self.torchrl_env.base_env.render())

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the renderer."""
        self.torchrl_env.base_env.camera.close()

    def _begin(self, worlds: Array) -> None:
        """Puts worlds ``(N,)`` bool into new episodes."""
        self._td["_reset"] = torch.from_numpy(worlds)[:, None]
        self._td = self.torchrl_env.reset(self._td)

    def _masked(self, options: dict[str, Any]) -> Array | None:
        """The worlds that a reset is for; all if ``None``."""
        mask = options.pop("reset_mask", None)
        _refuse(options)
        if mask is None:
            return None
        if self.autoreset_mode is not AutoresetMode.DISABLED or not hasattr(self, "_td"):
            raise ValueError(
                "reset_mask must come after a reset of all worlds, with "
                f"autoreset_mode=AutoresetMode.DISABLED, got {self.autoreset_mode}."
            )
        worlds = np.array(mask)
        if worlds.shape != (self.num_envs,) or worlds.dtype != bool:
            raise ValueError(
                f"reset_mask must be ({self.num_envs},) bool, got {worlds.shape} {worlds.dtype}."
            )
        return worlds


def _known_mode(render_mode: str | None) -> str | None:
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode must be rgb_array or None, got {render_mode!r}.")
    return render_mode


def _known_reset(mode: AutoresetMode | str) -> AutoresetMode:
    names = {name: known for known in AutoresetMode for name in (known, known.name, known.value)}
    if mode not in names:
        known = ", ".join(known.name for known in AutoresetMode)
        raise ValueError(f"autoreset_mode must be one of {known}, got {mode!r}.")
    return names[mode]


def _frame_rate(env: TransformedEnv) -> int:
    return round(1 / env.base_env.control_dt)


def _spaces(env: TransformedEnv) -> tuple[Box, Box]:
    """Observation and action space of one world."""
    size = env.observation_spec["observation"].shape[-1]
    return Box(-np.inf, np.inf, (size,), np.float32), Box(*action_bounds(env))


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
