"""When an episode ends."""

from collections.abc import Callable, Mapping

from tensordict import TensorDictBase
from torch import Tensor
from torch import bool as bool_
from torchrl.data import Binary, Composite
from torchrl.envs import StepCounter, Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms import bind
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.errors import in_one_line, named
from zfall.values import Positive


class Terminations(Transform):
    """Ends an episode for good as soon as one of several conditions holds.

    Keys: sets ``terminated`` and ``done`` ``(N, 1)`` where a condition holds, and writes each
    condition under ``("terminations", name)`` ``(N, 1)`` bool.

    Args:
        env: the base env; conditions that ask for ``robot`` or ``joint_range`` are given its own.
        conditions: ``name: condition``, a function of the TensorDicts before and after the step
            that returns ``(N, 1)`` bool. ``null`` leaves the condition out.

    Raises:
        ValueError: if a condition is none or, at the first step, reads what is not there or
            returns something else.
    """

    def __init__(self, env: HumanoidEnv, *, conditions: Mapping[str, Callable[..., Tensor] | None]):
        super().__init__()
        needs_env(self, env, "the ends of episodes")
        self.shape = (env.num_envs, 1)
        for name, condition in conditions.items():
            if condition is not None and not callable(condition):
                raise ValueError(f"conditions.{name} must be a function or null, got {condition}.")
        self.conditions = {}
        for name, condition in conditions.items():
            if condition is not None:
                with named(f"conditions.{name}"):
                    bound = bind(condition, robot=env.robot, joint_range=env.joint_range)
                self.conditions[name] = bound

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        terminated = next_tensordict["terminated"]
        for name, condition in self.conditions.items():
            try:
                holds = condition(tensordict, next_tensordict)
            except KeyError as error:
                raise ValueError(
                    f"conditions.{name} reads what is not there: {error.args[0]}"
                ) from error
            except Exception as error:
                raise ValueError(f"conditions.{name} failed: {in_one_line(error)}") from error
            if holds.shape != self.shape or holds.dtype != bool_:
                raise ValueError(
                    f"conditions.{name} must return {self.shape} bool, one per world, "
                    f"got {tuple(holds.shape)} {str(holds.dtype).removeprefix('torch.')}."
                )
            next_tensordict["terminations", name] = holds
            terminated = terminated | holds
        next_tensordict["terminated"] = terminated
        # Collectors look at "done" alone.
        return next_tensordict.set("done", next_tensordict["done"] | terminated)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        for name in self.conditions:
            tensordict_reset["terminations", name] = tensordict_reset["done"].clone()
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        shape = (*observation_spec.shape, 1)
        for name in self.conditions:
            observation_spec["terminations", name] = Binary(1, shape=shape, dtype=bool_)
        return observation_spec


def time_limit(env: HumanoidEnv, *, seconds: Positive, ends: bool = False) -> StepCounter:
    """Truncates an episode after so many seconds; counts its steps under ``step_count``.

    Args:
        env: the base env.
        seconds: how long an episode lasts.
        ends: whether it then terminates in place of being truncated: nothing after it counts.
            So it must where critics see ``step_count``: they never learn the value at the limit,
            which a truncated episode would add to its last reward. It looks like a fall to who
            counts those: name it in ``training_only``, and a curriculum's ``success``.

    Raises:
        ValueError: if that is not at least one control step.
    """
    steps = round(seconds / env.control_dt)
    if steps < 1:
        raise ValueError(f"seconds must be at least control_dt {env.control_dt}, got {seconds}.")
    return StepCounter(max_steps=steps, truncated_key="terminated" if ends else "truncated")
