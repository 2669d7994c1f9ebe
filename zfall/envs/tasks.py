"""Tasks by name: what all faces of an env make of a table."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from hydra.errors import HydraException, InstantiationException
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf.errors import OmegaConfBaseException
from torchrl.envs import Transform, TransformedEnv

from zfall.configs import compose_config, options_of, plain_containers
from zfall.envs.make import left_out, make_env
from zfall.errors import in_one_line
from zfall.static_checks import check_nodes

Table = Mapping[str, Any]  # as in recipes/env, a DictConfig for instance


def build_task(
    task: str | Table, *, num_envs: int, training: bool = True, overrides: Collection[str] = ()
) -> TransformedEnv:
    """The env of a task, without the observation that only a critic reads.

    Args:
        task: name of a table of ``recipes/env``, or a table.
        num_envs: number of worlds, in place of the table's.
        training: whether to keep what the table calls ``training_only``.
        overrides: values to change in a table named, written as for ``recipes.train``:
            ``env.transforms.push.duration=0.2``.

    Raises:
        ValueError: on an unknown name, overrides to a table that is no name, or values that the
            task cannot have.
    """
    if isinstance(task, str):
        task = _load_table(task, overrides)
    elif overrides:
        raise ValueError(f"overrides must be empty when task is a table, got {list(overrides)}.")
    threads = {"threads": 1} if num_envs == 1 else {}
    transforms = {k: v for k, v in task["transforms"].items() if not _is_for_critic(v)}
    gone = task["transforms"].keys() - transforms.keys()
    training_only = [name for name in left_out(task.get("training_only", {})) if name not in gone]
    try:
        base = instantiate(task["base_env"], num_envs=num_envs, **threads, _convert_="all")
        return make_env(base, transforms, training_only=training_only, training=training)
    except InstantiationException as error:
        raise ValueError(in_one_line(error)) from error


def action_bounds(env: TransformedEnv) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smallest and largest action of one world ``(J,)``, infinite where it has no bound."""
    space = env.full_action_spec["action"][0].space
    largest = np.finfo(np.float32).max  # what TorchRL's Unbounded says
    low, high = space.low.numpy(), space.high.numpy()
    return np.where(low <= -largest, -np.inf, low), np.where(high >= largest, np.inf, high)


def _is_for_critic(transform: Transform | Table) -> bool:
    """It reads quantities of transforms that are left out when not training."""
    return isinstance(transform, Mapping) and transform.get("out_key") == "observation_critic"


def _load_table(name: str, overrides: Collection[str]) -> Table:
    names = options_of("env")
    if name not in names:
        raise ValueError(f"task must be one of {', '.join(names)}, got {name!r}.")
    try:
        table: Table = compose_config([f"env={name}", "~experiment", *overrides]).env
        check_nodes(plain_containers(table), "env")
        return table
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ValueError(in_one_line(error)) from error
