"""A first step of a task, before anything is trained in it."""

from traceback import walk_tb

from hydra.utils import instantiate
from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from zfall.errors import at, in_one_line


def try_one_step(env_cfg: DictConfig) -> None:
    """Takes a step in two worlds of their own: terms and transforms that fail do so now.

    Raises:
        ValueError: naming the transform.
    """
    env = instantiate(env_cfg, base_env={"num_envs": 2})
    try:
        env.rollout(1)
    except Exception as error:
        name = failing(env, error)
        place = f"env.transforms.{name}" if name else "env"
        raise ValueError(at(place, in_one_line(error))) from error


def failing(env: TransformedEnv, error: Exception) -> str | None:
    """Name of the transform of a task in whose method an error was raised, if it was in one."""
    innermost = None
    for frame, _ in walk_tb(error.__traceback__):
        owner = frame.f_locals.get("self")
        for name, transform in getattr(env.transform, "by_name", {}).items():
            if transform is owner:
                innermost = name
    return innermost
