"""The physics below a transform, and what a transform says that has none.

A transform that draws, acts or remembers belongs to one ``HumanoidEnv``. Its constructor says so
by ``needs_env``; it finds the env by ``base_env_of``, so that a clone or a copy acts on the env
that it is part of. In a replay buffer, in a model or around a batch of envs it is refused in one
line. All others work on data of any batch size, too: their ``forward`` is ``on_data``.
"""

from collections.abc import Iterable
from typing import Any, NoReturn

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase, Transform, TransformedEnv

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.streams import Stream


def needs_env(transform: Transform, env: EnvBase, needs: str) -> None:
    """Says in a constructor that a transform belongs to an env like the one it is built with.

    Args:
        transform: that is built.
        env: the base env, or transforms around it.
        needs: what it needs of its env, for messages: ``a memory of each world``.

    Raises:
        ValueError: if ``env`` is not a ``HumanoidEnv``.
    """
    needs_steps(transform, needs)
    transform.__dict__["_built_with"] = _below(transform, env)  # not one of its modules


def needs_steps(transform: Transform, needs: str) -> None:
    """Says in a constructor that a transform works in an env alone, of any kind, not on data."""
    transform._needs = needs
    transform.register_forward_pre_hook(_refuse_data)


def base_env_of(transform: Transform) -> HumanoidEnv:
    """The base env of the env that a transform is part of; alone, that it is built with.

    Raises:
        ValueError: if there is none, or another kind of env than it is built with.
    """
    built_with = transform.__dict__.get("_built_with")
    try:
        env = transform.container
    except ValueError:  # in a Compose that is part of no env
        built_with = env = None
    env = built_with if env is None else env
    if env is None:
        _refuse_data(transform)
    base = _below(transform, env)
    if built_with is not None and base is not built_with and _kind(base) != _kind(built_with):
        raise ValueError(
            f"{type(transform).__name__} must be built with an env like the one it is part of, of "
            f"{_words(base)}; got one of {_words(built_with)}."
        )
    return base


def check_recorded(transform: Transform, spec: Composite, keys: Iterable[NestedKey]) -> None:
    """Refuses a transform in an env that does not record ``keys`` at every physics step.

    Its constructor has made another env do so.
    """
    base_env_of(transform)
    missing = [key for key in keys if ("substeps", key) not in spec.keys(True)]
    if missing:
        raise ValueError(
            f"{type(transform).__name__} must be built with the env that it is part of, for "
            f"{_needs(transform)}; got one that does not record {missing[0]}: call its "
            f"record_substeps before transforms are put around it."
        )


def streams_of(transform: Transform, part: str | None = None) -> Stream:
    """Where a transform draws its random numbers: one stream for each world of its env.

    They are those of the name that it has in a table of ``make_env``, else of its class.

    Args:
        transform: that draws.
        part: of what it draws, with streams of its own; ``None`` if there is one kind of draw.
    """
    purpose = transform.__dict__.get("_purpose", type(transform).__name__)
    return base_env_of(transform).streams.of(f"{purpose}.{part}" if part else purpose)


def name_streams(name: str, transform: Transform) -> None:
    """Gives a transform, and those in it, the streams that belong to its name in a table."""
    for place, part in transform.named_modules():
        part.__dict__["_purpose"] = f"{name}.{place}".rstrip(".")


def normal_for(transform: Transform, value: Tensor, rows: Tensor | None = None) -> Tensor:
    """Numbers from N(0, 1) of the shape of a value ``(N, ...)``, which an env may have made or not.

    By torch's global generator if the transform was built without an env.

    Args:
        transform: that draws.
        value: of which only the shape is used.
        rows: the worlds that draw; all if ``None``.
    """
    if "_built_with" in transform.__dict__:
        return streams_of(transform).normal(value.shape[1:], rows)
    return torch.randn(value.shape)


def uniform_for(transform: Transform, value: Tensor, rows: Tensor | None = None) -> Tensor:
    """Uniform numbers in [0, 1), arguments as in ``normal_for``."""
    if "_built_with" in transform.__dict__:
        return streams_of(transform).uniform(value.shape[1:], rows)
    return torch.rand(value.shape)


def on_data(transform: Transform, tensordict: TensorDictBase) -> TensorDictBase:
    """``forward`` of a transform that needs no env, for a sampled batch: its ``_call``."""
    return transform._call(tensordict)


def _refuse_data(transform: Any, args: object = None) -> NoReturn:
    name = type(transform).__name__
    raise ValueError(
        f"{name} must be part of an env, for {_needs(transform)}, which a replay buffer, a model "
        f"or a Compose alone does not have; got none. Put it into the table of make_env, or "
        f"TransformedEnv(base_env, {name}(base_env, ...))."
    )


def _below(transform: Transform, env: EnvBase) -> HumanoidEnv:
    """The base env in ``env``."""
    while isinstance(env, TransformedEnv):
        env = env.base_env
    if not isinstance(env, HumanoidEnv):
        name = type(transform).__name__
        raise ValueError(
            f"{name} must stand in an env around a HumanoidEnv, for {_needs(transform)}, got "
            f"{type(env).__name__}. Put it inside: SerialEnv(2, lambda: TransformedEnv(base_env, "
            f"{name}(base_env, ...)))."
        )
    return env


def _needs(transform: Transform) -> str:
    """What it said in its constructor."""
    return str(getattr(transform, "_needs", "its physics"))


def _kind(env: HumanoidEnv) -> tuple[int, float, float, tuple[str, ...]]:
    """What constants and buffers of a transform follow from."""
    return env.num_envs, env.control_dt, env.physics_dt, tuple(env.robot.joints)


def _words(env: HumanoidEnv) -> str:
    return (
        f"{env.num_envs} worlds, control_dt {env.control_dt}, physics_dt {env.physics_dt} and "
        f"{len(env.robot.joints)} joints"
    )
