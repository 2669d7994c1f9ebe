"""What holds for every transform and every table of them."""

import re
from pathlib import Path

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch.testing import assert_close
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp

from tests.envs.transforms.table import TABLE, TARGETS, build
from zfall.envs import transforms
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env

TABLES = st.tuples(
    st.sampled_from(list(TARGETS)),
    st.sets(st.sampled_from(list(TABLE)), min_size=1).map(lambda names: names | {"limit"}),
)
ELSEWHERE = {
    "ForeignJointTarget",  # another kind of target, see foreign/test_target.py
    "ScriptedStart",  # of Python alone, see test_starts.py
}
EVERYTHING = ("position", set(TABLE))


def run(env: TransformedEnv, td, steps: int, seed: int):
    """Random actions, episodes that end and begin; the data and what goes on from them."""
    generator, seen = torch.Generator().manual_seed(seed), []
    for _ in range(steps):
        td["action"] = 0.5 * torch.randn(env.action_spec.shape, generator=generator)
        data, td = env.step_and_maybe_reset(td)
        seen.append(data["next"].clone())
    return seen, td


def equal(one, other, rows=slice(None)) -> None:
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    for key in one.keys(True, True):
        assert torch.equal(one[key][rows], other[key][rows]), key


def test_no_transform_is_missing_here():
    folder = Path(transforms.__file__).parent
    texts = (path.read_text() for path in folder.rglob("*.py"))
    there = {
        name for text in texts for name in re.findall(r"^class (\w+)\(Transform\)", text, re.M)
    }
    built = {type(t).__name__ for target in TARGETS for t in build((target, set(TABLE))).transform}
    assert len(there) > 40
    assert there <= built | ELSEWHERE


@settings(max_examples=6, deadline=None, derandomize=True)
@given(TABLES)
def test_specs_hold(table):
    check_env_specs(build(table))


def test_specs_hold_with_everything_on():
    for target in TARGETS:
        check_env_specs(build((target, set(TABLE))))


@settings(max_examples=6, deadline=None, derandomize=True)
@given(TABLES, st.lists(st.booleans(), min_size=4, max_size=4).filter(any), st.integers(0, 99))
@example(EVERYTHING, [True, False, True, False], 0)
@example(("velocity", set(TABLE)), [False, False, True, False], 1)
def test_partial_reset_equals_full_reset_on_its_rows(table, mask, seed):
    """Two equal envs, one reset in full, the other in some rows: those rows stay equal.

    Levels of the curriculum move with the ends of episodes, so both envs end the same ones.
    """
    env, other = build(table), build(table)
    starts = []
    for one, rows in ((env, [True] * 4), (other, mask)):
        _, td = run(one, one.reset(), 5, seed)
        td["_reset"] = torch.tensor(rows)[:, None]
        starts.append(one.reset(td).exclude("_reset", "action"))
    rows = torch.tensor(mask)
    equal(starts[0], starts[1], rows)
    seen = [run(one, td, 4, seed)[0] for one, td in zip((env, other), starts, strict=True)]
    for one, two in zip(*seen, strict=True):
        equal(one, two, rows)


@settings(max_examples=4, deadline=None, derandomize=True)
@given(TABLES, st.permutations(range(4)), st.integers(0, 99))
@example(EVERYTHING, [3, 1, 0, 2], 0)
@example(("velocity", set(TABLE)), [0, 1, 2, 3], 1)
@example(("position", {"start", "limit"}), [0, 1, 2, 3], 1)  # which another start replaces above
def test_a_world_is_the_same_in_any_company(table, places, seed):
    """Worlds 1 and 2 of four, elsewhere among six others that begin anew at other times.

    Levels of the curriculum move with the ends of all episodes.
    """
    table = table[0], table[1] - {"curriculum"}
    few, many = build(table), build(table, num_envs=6)
    many.base_env.streams.begin(0, [*places, 8, 9])
    rows = torch.tensor([places.index(1), places.index(2)])
    generator, others = torch.Generator().manual_seed(seed), torch.ones(6, 1, dtype=torch.bool)
    others[rows] = False
    one, two = few.reset(), many.reset()
    for step in range(12):
        equal(one[1:3].exclude("action"), two[rows].exclude("action"))
        one["action"] = 0.5 * torch.randn(few.action_spec.shape, generator=generator)
        two["action"] = 0.5 * torch.randn(many.action_spec.shape, generator=generator)
        two["action"][rows] = one["action"][1:3]
        one, (_, two) = few.step_and_maybe_reset(one)[1], many.step_and_maybe_reset(two)
        if step % 4 == 1:
            two = many.reset(two.set("_reset", others)).exclude("_reset")


@settings(max_examples=6, deadline=None, derandomize=True)
@given(TABLES, st.integers(1, 12), st.integers(0, 99))
def test_a_restored_env_goes_on_bit_for_bit(table, steps, seed):
    check_restored(table, steps, seed)


@pytest.mark.parametrize("steps", [3, 11])
def test_a_restored_env_goes_on_bit_for_bit_with_everything_on(steps):
    check_restored(EVERYTHING, steps, seed=1)


def check_restored(table, steps: int, seed: int) -> None:
    env, other = build(table), build(table)
    _, td = run(env, env.reset(), steps, seed)
    state, carrier = env.state_dict(), td.clone()
    expected, _ = run(env, td, 10, seed + 1)
    run(other, other.reset(), 2, seed + 2)  # somewhere else by now
    other.load_state_dict(state)
    found, _ = run(other, carrier, 10, seed + 1)
    for one, two in zip(expected, found, strict=True):
        equal(one, two)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.permutations(["planner", "backlash", "low_pass", "delay"]))
def test_the_order_of_the_table_is_the_order_of_data(order):
    """Commands through the chain at once equal those through each transform on its own."""
    base = HumanoidEnv(num_envs=2, control_dt=0.04)
    env = make_env(base, {"action": TARGETS["position"]} | {name: TABLE[name] for name in order})
    alone = [make_env(HumanoidEnv(num_envs=2, control_dt=0.04), {"a": TABLE[n]}) for n in order]
    seen: list[torch.Tensor] = []
    step = base._step
    base._step = lambda td: seen.append(td["control"].clone()) or step(td)
    env.set_seed(0)
    td = env.reset()
    for one in alone:
        one.reset()
    delay = next(t for t in env.transform if hasattr(t, "lag"))
    twin = next(one.transform[0] for one, n in zip(alone, order, strict=True) if n == "delay")
    twin.lag = delay.lag.clone()
    for _ in range(4):
        td["action"] = torch.randn(2, 20)
        data, td = env.step_and_maybe_reset(td)
        command = data["next"].select("target")
        for one in alone:
            command = one.transform[0]._inv_call(command)
        assert_close(seen[-1], command["control"])


def test_nothing_that_belongs_to_one_step_stays_for_the_next():
    """A wrench that stayed would be added to again."""
    env = build(EVERYTHING)
    td = env.reset()
    td["action"] = torch.zeros(4, 20)
    following = step_mdp(env.step(td))
    assert ("push", "wrench") not in following.keys(True)
    assert "control" not in following.keys()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("steps", "mask"), [(5, [True] * 4), (12, [True, False, True, False])])
def test_a_reset_forgets_all_that_was_before(target, steps, mask):
    """Rows reset equal those of an env newly built, from the same random numbers on.

    All but the curriculum, whose levels outlive episodes.
    """
    table = target, set(TABLE) - {"curriculum"}
    used, new = build(table), build(table)
    _, td = run(used, used.reset(), steps, seed=3)
    new.base_env.streams.load_state_dict(used.base_env.streams.state_dict())
    rows = torch.tensor(mask)
    td["_reset"] = rows[:, None]
    begun = used.reset(td).exclude("_reset", "action"), new.reset()
    equal(*begun, rows)
    for one, two in zip(
        *(run(e, td, 8, 5)[0] for e, td in zip((used, new), begun, strict=True)), strict=True
    ):
        equal(one, two, rows)
