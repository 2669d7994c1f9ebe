"""TorchRL's matrix of tests for transforms, for all of ours: a new transform is one row.

The columns are those of ``TransformBase`` in TorchRL's own tests, and what a user may do with an
env beyond them. What a row does in each follows from where its transform belongs.
"""

import copy
import importlib
import pickle
import pkgutil
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, ParallelEnv, SerialEnv, Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

import zfall
from tests.envs.transforms.table import OF_TARGET, TABLE, TARGETS, build_base, choose
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import build_transform, make_env
from zfall.envs.transforms.base_env import name_streams
from zfall.envs.transforms.starts import ScriptedStart
from zfall.robots import ZEROTH01

DATA, STEPS, PHYSICS = "data", "steps", "physics"  # what a transform works on
ON = dict.fromkeys(
    ("action", "zero", "noise", "bits", "angles", "base_pose", "feet", "imu", "imu_to_heading",
     "observation", "normalized", "near", "foreign_target"), DATA,
) | {"last_action": STEPS}  # fmt: skip
WITHOUT_ENV = {"noise", "near"}  # on data they draw from torch's own generator
ROWS = [
    "action",
    "velocity",
    "foreign_target",
    *(name for name in TABLE if name != "limit"),
    "scripted",
]
WHOLE = {f"all with {target} targets": target for target in TARGETS}  # at once
FOREIGN_TARGET = {
    "_target_": "zfall.envs.transforms.foreign.ForeignJointTarget",
    "joints": sorted(ZEROTH01.joints),
    "scale": 0.4,
}
NOT_ROWS = {"DropSubsteps"}  # the end of each table that make_env builds


class Row:
    """A transform, in the table that it needs."""

    def __init__(self, name: str):
        self.name, self.on = name, ON.get(name, PHYSICS)
        velocity = name in {"velocity", *OF_TARGET["velocity"]}
        self.key = "action" if name in {"velocity", "foreign_target"} else name
        target, names = "velocity" if velocity else "position", {name} & set(TABLE)
        if name in WHOLE:
            target, names = WHOLE[name], set(TABLE)
        self.table = choose(target, names)
        if name == "foreign_target":
            self.table = {"action": FOREIGN_TARGET}
        if name == "scripted":
            self.table = {"scripted": None, **self.table}

    def transform(self, base: HumanoidEnv, key: str | None = None) -> Transform:
        """That of the row, or another one of its table."""
        key = key or self.key
        if key == "scripted":
            state = torch.full((base.num_envs, 20), 0.1)
            return ScriptedStart(base, states={"joint_position": state})
        torch.manual_seed(0)  # of the networks that transforms bring
        return build_transform(self.table[key], base)

    def alone(self, base: HumanoidEnv) -> Transform:
        """As for data."""
        if self.name in WITHOUT_ENV:
            return instantiate(self.table[self.key], None)
        return self.transform(base)

    def all(self, base: HumanoidEnv) -> dict[str, Transform]:
        return {key: self.transform(base, key) for key in self.table}

    def env(self, base: HumanoidEnv | None = None) -> TransformedEnv:
        base = base or build_base(num_envs=2)
        env = make_env(base, self.all(base))
        env.set_seed(0)
        return env

    def env_before(self) -> TransformedEnv:
        """What the transform is put around: its table without it and what comes after."""
        base = build_base(num_envs=2)
        keys = list(self.table)
        return make_env(base, {k: self.transform(base, k) for k in keys[: keys.index(self.key)]})


@lru_cache
def base_to_build_with() -> HumanoidEnv:
    return build_base(num_envs=2)


def run(env: Any, steps: int = 4) -> TensorDictBase:
    """Random actions; episodes end and begin."""
    generator, td = torch.Generator().manual_seed(1), env.reset()
    seen = []
    for _ in range(steps):
        td["action"] = 0.5 * torch.randn(*env.batch_size, 20, generator=generator)
        data, td = env.step_and_maybe_reset(td)
        seen.append(data.clone())
    return torch.stack(seen, -1)


def assert_same(one: TensorDictBase, other: TensorDictBase) -> None:
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        assert torch.equal(one[key], other[key]), key


def alone_in_an_env(row: Row) -> None:
    check_env_specs(row.env())


def in_a_compose(row: Row) -> None:
    """As a user of TorchRL writes it, commands and starts from last to first; the same bits.

    Each under the name that it has in the table, which its random numbers come by.
    """
    expected = run(row.env())
    base = build_base(num_envs=2)
    table = row.all(base)
    for name, transform in table.items():
        name_streams(name, transform)
        if hasattr(transform, "attach"):
            transform.attach(table)
    inverse = [t for t in table.values() if t.in_keys_inv]
    starts = [t for t in table.values() if "_reset_env_preprocess" in vars(type(t))]
    starts = [t for t in starts if t not in inverse]
    rest = [t for t in table.values() if t not in (*inverse, *starts)]
    order = (Compose(*reversed(starts)), Compose(*reversed(inverse)), *rest)
    env = TransformedEnv(base, Compose(*order))
    env.set_seed(0)
    found = run(env)
    assert_same(found.select(*expected.keys(True, True)), expected)


def in_serial(row: Row) -> None:
    check_env_specs(SerialEnv(2, row.env))


def in_parallel(row: Row) -> None:
    env = ParallelEnv(2, row.env, mp_start_method="fork")
    try:
        check_env_specs(env)
    finally:
        env.close()


def around_a_batch(row: Row, batch: Callable[..., Any] = SerialEnv) -> None:
    inner = batch(2, row.env_before)
    try:
        env = TransformedEnv(inner, row.alone(base_to_build_with()))
        check_env_specs(env)
    finally:
        inner.close(raise_if_closed=False)


def around_parallel(row: Row) -> None:
    around_a_batch(row, partial(ParallelEnv, mp_start_method="fork"))


@lru_cache(maxsize=1)
def batch_of(name: str) -> TensorDictBase:
    """A batch ``(*B,)`` of a row's env."""
    return run(Row(name).env(), 3)


def data_of(row: Row) -> tuple[TensorDictBase, Transform]:
    """A batch ``(*B,)`` of the row's env, and its transform to be used on that."""
    return batch_of(row.name).clone(), row.alone(base_to_build_with())


def on_data(row: Row) -> None:
    """What it writes is what it wrote in the env, for a batch of any size."""
    data, transform = data_of(row)
    given = data.exclude(*transform.out_keys)
    found = transform(given)
    for key in transform.out_keys:
        if row.name in WITHOUT_ENV:
            assert found[key].shape == data[key].shape
        else:
            assert torch.equal(found[key], data[key]), key


def in_a_replay_buffer(row: Row) -> None:
    data, transform = data_of(row)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(20), batch_size=6)
    buffer.append_transform(transform)
    buffer.extend(data.reshape(-1).exclude(*transform.out_keys))
    sample = buffer.sample()
    assert sample.batch_size == (6,)
    assert all(key in sample.keys(True) for key in (*transform.out_keys, *transform.in_keys_inv))


def in_a_model(row: Row) -> None:
    data, transform = data_of(row)
    key = (transform.out_keys or ["action"])[0]
    head = TensorDictModule(lambda x: x.sum(-1), in_keys=[key], out_keys=["sum"])
    model = torch.nn.Sequential(transform, head)
    assert "sum" in model(data.exclude(*transform.out_keys)).keys()


def in_a_compose_on_data(row: Row) -> None:
    data, transform = data_of(row)
    chain = Compose(transform)
    chain(chain.inv(data))


def cloned(row: Row) -> None:
    """A clone of all transforms, around an equal base env: the same bits."""
    env = row.env()
    base = build_base(num_envs=2)
    row.all(base)  # some have it record what they need
    other = TransformedEnv(base, env.transform.clone())
    other.set_seed(0)
    assert_same(run(other), run(env))


def copied(row: Row, copying: Callable[[Any], Any] = copy.deepcopy) -> None:
    """An env that has been copied in the midst goes on like the other, bit for bit."""
    env = row.env()
    run(env)
    other = copying(env)
    assert_same(run(other), run(env))


def pickled(row: Row) -> None:
    copied(row, lambda env: pickle.loads(pickle.dumps(env)))


def saved(row: Row) -> None:
    """Transform and base env restored by ``state_dict`` go on, bit for bit."""
    env, other = row.env(), row.env()
    run(env)
    states = env.base_env.state_dict(), env.transform.state_dict()
    expected = run(env)
    other.base_env.load_state_dict(states[0])
    other.transform.load_state_dict(states[1])
    assert_same(run(other), expected)


IN_ENVS = {
    "in an env": alone_in_an_env,
    "in `Compose`": in_a_compose,
    "in `SerialEnv`": in_serial,
    "in `ParallelEnv`": in_parallel,
    "`clone`": cloned,
    "`deepcopy`": copied,
    "`pickle`": pickled,
    "`state_dict`": saved,
}
AROUND = {"around `SerialEnv`": around_a_batch, "around `ParallelEnv`": around_parallel}
ON_DATA = {
    "on data": on_data,
    "in a replay buffer": in_a_replay_buffer,
    "in a model": in_a_model,
    "`Compose` on data": in_a_compose_on_data,
}
COLUMNS = IN_ENVS | AROUND | ON_DATA
ALONE = ["in an env", "around `SerialEnv`", *ON_DATA]  # each row by itself, without -m slow


def works(row: Row, column: str) -> bool:
    """What the docs say."""
    return column in IN_ENVS or row.on == DATA or (column in AROUND and row.on == STEPS)


def check(row: Row, column: str) -> None:
    if works(row, column):
        COLUMNS[column](row)
        return
    name = type(row.transform(base_to_build_with())).__name__
    with pytest.raises(ValueError, match=f"^{name} must (be part of|stand in) an env") as caught:
        COLUMNS[column](row)
    assert "\n" not in str(caught.value)


def cells() -> list[Any]:
    """Rows and columns; the slow ones are those of whole tables, for each row by itself."""
    whole = [(name, column) for name in WHOLE for column in IN_ENVS]
    sample = [(name, "around `ParallelEnv`") for name in ("late", "bits")]
    quick = [*whole, *sample, *((name, column) for name in ROWS for column in ALONE)]
    slow = [(name, c) for name in ROWS for c in COLUMNS if (name, c) not in set(quick)]
    return [*quick, *(pytest.param(*cell, marks=pytest.mark.slow) for cell in slow)]


@pytest.mark.parametrize(("name", "column"), cells())
def test_a_transform_works_or_says_why_not(name, column):
    check(Row(name), column)


def every_transform() -> set[str]:
    """Names of all transforms of the project."""
    for module in pkgutil.walk_packages(zfall.__path__, "zfall."):
        importlib.import_module(module.name)

    def below(cls: type) -> set[type]:
        return {cls}.union(*(below(one) for one in cls.__subclasses__()))

    found = {cls for cls in below(Transform) if cls.__module__.startswith("zfall.")}
    return {cls.__name__ for cls in found if not issubclass(cls, Compose)}


def test_no_transform_is_without_a_row():
    base = build_base()
    there = {type(Row(name).transform(base)).__name__ for name in ROWS}
    assert every_transform() - NOT_ROWS == there


PAGE = Path(zfall.__file__).parents[1] / "docs" / "reference" / "transforms-matrix.md"
BEGIN = "<!-- written by python -m tests.envs.transforms.test_matrix -->\n"


def page() -> str:
    """The table of the docs."""
    lines = [
        "| transform | in envs | around a batch of envs | on data | needs |",
        "|---|---|---|---|---|",
    ]
    found = {}
    for row in map(Row, ROWS):
        transform = row.transform(base_to_build_with())
        words = ["works" if works(row, c) else "refused" for c in ("clone", *AROUND, *ON_DATA)]
        around, data = words[1], words[-1]
        place = type(transform).__module__.removeprefix("zfall.").removeprefix("envs.transforms.")
        needs = getattr(transform, "_needs", "") if row.on != DATA else ""
        found[f"`{place.split('.')[0]}.{type(transform).__name__}`"] = (around, data, needs)
    for name, (around, data, needs) in sorted(found.items()):
        lines.append(f"| {name} | works | {around} | {data} | {needs} |")
    return "\n".join(lines) + "\n"


def test_the_docs_say_what_works():
    assert PAGE.read_text().partition(BEGIN)[2] == page()


if __name__ == "__main__":
    PAGE.write_text("".join(PAGE.read_text().partition(BEGIN)[:2]) + page())
