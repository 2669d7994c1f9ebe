"""The dm_control face: a task as an Environment, for the viewer and for tools of dm_env."""

from collections.abc import Collection
from functools import partial
from typing import Any

import numpy as np
import torch
from dm_control.mujoco import wrapper
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv, step_mdp

from zfall.envs.tasks import Table, action_bounds, build_task
from zfall.simulation.dm_control import Physics, PhysicsSimulation


def load(
    task: str | Table = "push_recovery",
    *,
    training: bool = True,
    random: int | np.random.RandomState | None = None,
    time_limit: float = float("inf"),
    overrides: Collection[str] = (),
) -> control.Environment:
    """A task as a dm_control environment: ``dm_control.viewer.launch(load("push_recovery"))``.

    From the same start, with the same actions and pushes, it goes through the same states as the
    TorchRL env. Observations are the ``observation`` of the table. An episode that terminates
    ends with discount 0, one that is truncated with discount 1.

    Args:
        task: name of a table of ``recipes/env``, or a table.
        training: whether to keep what the table calls ``training_only``: pushes, noise, delays.
        random: seed of starts, pushes and noise, or the generator that seeds each episode.
        time_limit: dm_control's own limit of an episode [s]; the table has one too.
        overrides: values to change in a table named, written as for ``recipes.train``.

    Raises:
        ValueError: on an unknown name, or overrides to a table that is no name.
    """
    env = build_task(task, num_envs=1, training=training, overrides=overrides)
    base = env.base_env
    physics = Physics.from_model(wrapper.MjModel(base.simulation.model))
    physics.robot = base.robot
    task = TableTask(env, physics, random=random)
    return control.Environment(physics, task, time_limit=time_limit, n_sub_steps=base.substeps)


class TableTask(control.Task):
    """A table of transforms as a dm_control task.

    It holds the TorchRL env of one world, whose physics steps are taken by the ``Physics``, so
    that pushes, delays, noise, reward and terminations are the same code.

    Args:
        env: the env of one world.
        physics: on the model of that env.
        random: seed of starts, pushes and noise, or the generator that seeds each episode.
    """

    def __init__(
        self,
        env: TransformedEnv,
        physics: Physics,
        *,
        random: int | np.random.RandomState | None = None,
    ):
        # TorchRL's DMControlWrapper sets a new generator under this name.
        self._random = (
            random if isinstance(random, np.random.RandomState) else np.random.RandomState(random)
        )
        self.torchrl_env = env
        self._drive(physics)
        self._td = env.reset()

    @property
    def random(self) -> np.random.RandomState:
        """The generator that seeds each episode."""
        return self._random

    def initialize_episode(self, physics: Physics) -> None:
        """Puts the physics into a start state of the table."""
        if self._simulation.physics is not physics:  # a copy, for instance
            self._drive(physics)
        self.torchrl_env.base_env.set_seed(int(self._random.randint(2**31)))
        self._td = self.torchrl_env.reset()

    def _drive(self, physics: Physics) -> None:
        base = self.torchrl_env.base_env
        self._simulation = base.simulation = PhysicsSimulation(physics, base.substeps)

    def before_step(self, action: Any, physics: Physics) -> None:
        """Plans the control step that ``physics.step`` then takes."""
        action = torch.from_numpy(np.array(action, dtype=np.float32))
        td = step_mdp(self._td) if "next" in self._td.keys() else self._td
        td["action"] = action[None]
        physics.at_next_step(partial(self._advance, td))

    def _advance(self, td: TensorDictBase) -> None:
        self._td = self.torchrl_env.step(td)

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Bounds of the action ``(J,)``, those of the TorchRL env."""
        low, high = action_bounds(self.torchrl_env)
        return specs.BoundedArray(low.shape, low.dtype, low, high, name="action")

    def observation_spec(self, physics: Physics) -> dict[str, specs.Array]:
        """Shape of ``get_observation``."""
        return {
            k: specs.Array(v.shape, v.dtype, k) for k, v in self.get_observation(physics).items()
        }

    def get_observation(self, physics: Physics) -> dict[str, NDArray[np.float32]]:
        """The table's ``observation`` ``(D,)``, after the step or the reset."""
        return {"observation": self.outcome["observation"][0].numpy().copy()}

    def get_reward(self, physics: Physics) -> float:
        """Reward of the step just taken."""
        return self.outcome["reward"].item()

    def get_termination(self, physics: Physics) -> float | None:
        """0 where the episode has terminated, 1 where it was truncated, else nothing."""
        if self.outcome["terminated"].item():
            return 0.0
        return 1.0 if self.outcome["truncated"].item() else None

    @property
    def outcome(self) -> TensorDictBase:
        """All that the TorchRL env gave after the step or the reset, for its one world."""
        return self._td.get("next", self._td)
