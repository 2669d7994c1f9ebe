"""Puts a task together: a base env and a table of transforms."""

import inspect
from collections.abc import Collection, Mapping
from typing import Any

from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, open_dict
from torchrl.envs import EnvBase, Transform, TransformedEnv

from zfall.configs import plain_containers
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.table_env import DropSubsteps, Table, TableEnv
from zfall.envs.transforms.actions.commands import check_order
from zfall.envs.transforms.base_env import name_streams
from zfall.errors import named
from zfall.static_checks import check_nodes


def make_env(
    base_env: EnvBase | Mapping[str, Any],
    transforms: Mapping[str, Transform | Mapping[str, Any] | None],
    *,
    training_only: Mapping[str, bool] | Collection[str] = (),
    training: bool = True,
) -> TableEnv:
    """Builds an env whose transforms run in the order of the table, which is that of the data.

    Those that work on the way from the policy to the physics (they have ``in_keys_inv``) run in
    the order given, before the step; the others run in the order given, after it. TorchRL runs
    the first kind from last to first: here the table is turned around for it.

    Args:
        base_env: the env, or its config with a ``_target_``.
        transforms: by name, transforms or their configs, see ``build_transform``. A method
            ``attach`` is called with the table of all that were built. A config may say
            ``before: NAME``, to stand there and not where it was written: at the end, if the
            shell added it. ``None`` is left out.
        training_only: names of transforms that evaluation leaves out: pushes, noise, delays,
            randomisation; or a table ``name: true``.
        training: whether to keep them.

    Raises:
        ValueError: if ``training_only`` or ``before`` names a transform that is not in the table,
            a transform acts on commands before they are made, something is measured after the
            observation that should hold it, or a transform writes a key that it does not declare.
    """
    training_only = left_out(training_only)
    unknown = [name for name in training_only if name not in transforms]
    if unknown:
        raise ValueError(
            f"training_only must name transforms of the table ({', '.join(transforms)}), "
            f"got {', '.join(unknown)}; a transform that is left out may stay in this list if it "
            "is null in the table."
        )
    env = base_env if isinstance(base_env, EnvBase) else instantiate(base_env, _convert_="all")
    ordered = in_place(transforms)
    used = {k: v for k, v in ordered.items() if training or k not in training_only}
    built = {name: build_transform(t, env, f"transforms.{name}") for name, t in used.items()}
    for name, transform in built.items():
        name_streams(name, transform)
        if hasattr(transform, "attach"):
            transform.attach(built)
    check_order((f"transforms.{name}", transform) for name, transform in built.items())
    before = [transform for transform in built.values() if transform.in_keys_inv]
    after = [transform for transform in built.values() if not transform.in_keys_inv]
    if "substeps" in env.observation_spec.keys():
        after.append(DropSubsteps())
    task = TableEnv(env, Table(*reversed(before), *after))
    task.transform.by_name = built  # for messages
    _check_measured(built)
    _check_declared(task, built)
    return task


def in_place(
    transforms: Mapping[str, Transform | Mapping[str, Any] | None],
) -> dict[str, Transform | Mapping[str, Any]]:
    """The table in the order that its ``before`` ask for, without them and without ``None``."""
    table = {name: each for name, each in transforms.items() if each is not None}
    for name, transform in list(table.items()):
        if isinstance(transform, Transform):
            continue
        if not isinstance(transform, Mapping) or "_target_" not in transform:
            raise ValueError(
                f"transforms.{name} must be a table with a _target_, or null, got {transform}; its "
                f"values are transforms.{name}.KEY."
            )
        if "before" not in transform:
            continue
        place = transform["before"]
        if place not in table or place == name:
            raise ValueError(
                f"{name}.before must name another transform of the table "
                f"({', '.join(transforms)}), got {place}."
            )
        table.pop(name)
        moved: dict[str, Any] | DictConfig
        if isinstance(transform, DictConfig):  # a copy knows its place, for messages
            moved = transform.copy()
            with open_dict(moved):
                del moved["before"]
        else:
            moved = {key: value for key, value in transform.items() if key != "before"}
        at = list(table).index(place)
        items = list(table.items())
        table = dict([*items[:at], (name, moved), *items[at:]])
    return table


def _check_measured(built: Mapping[str, Transform]) -> None:
    """Refuses sensing that comes too late: the observation would quietly go without it."""
    read: dict[Any, str] = {}
    for name, transform in built.items():
        for key in transform.out_keys or []:
            if isinstance(key, tuple) and key[0] == "measured" and key[1] in read:
                raise ValueError(
                    f"transforms.{name} must come before {read[key[1]]}, which reads {key[1]}: "
                    f"give it before: {read[key[1]]}."
                )
        reads = getattr(transform, "measured", ())  # keys, or true: all that it reads
        read |= dict.fromkeys(transform.in_keys if reads is True else reads or (), name)


def _check_declared(task: TransformedEnv, built: Mapping[str, Transform]) -> None:
    """Refuses transforms that write what no spec holds, which TorchRL does without naming them."""
    try:
        task.output_spec  # noqa: B018 (works the specs out)
    except KeyError as error:
        for name, transform in built.items():
            for key in transform.out_keys or []:
                if f"{key!r} is unaccounted for" in str(error):
                    raise ValueError(
                        f"transforms.{name} must declare the key {key!r} it writes: "
                        "transform_observation_spec has to add it to the spec it is given."
                    ) from None
        raise


def left_out(training_only: Mapping[str, bool] | Collection[str]) -> list[str]:
    """Names of the transforms that evaluation leaves out."""
    if isinstance(training_only, Mapping):
        return [name for name, only in training_only.items() if only]
    return list(training_only)


def build_transform(
    transform: Transform | Mapping[str, Any], env: HumanoidEnv, place: str = "transform"
) -> Transform:
    """A transform from its config.

    The hook for a transform that has to know the robot, the physics or the random generator: if
    the first parameter of its class or function is named ``env``, it is the base env. All other
    parameters come from the config.

    Args:
        transform: its config, with a ``_target_``; a transform is returned as it is.
        env: the base env.
        place: key of the config, for messages.

    Raises:
        ValueError: on a config that does not fit (``zfall.static_checks``), or that of something
            else; naming the place.
    """
    if isinstance(transform, Transform):
        return transform
    plain = plain_containers(transform) if isinstance(transform, DictConfig) else transform
    check_nodes(plain, place)
    no_transform = f"{place}._target_ must make a TorchRL Transform, got {transform['_target_']}."
    try:
        parameters = inspect.signature(get_object(transform["_target_"])).parameters
    except ValueError as error:  # a built-in one, without a signature
        raise ValueError(no_transform) from error
    args = (env,) if next(iter(parameters), None) == "env" else ()
    config = transform if isinstance(transform, DictConfig) else dict(transform)
    with named(place):
        built = instantiate(config, *args, _convert_="all")
    if not isinstance(built, Transform):
        raise ValueError(no_transform)
    return built
