"""The table of reward terms."""

from functools import partial

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.terms.effort import joint_limits
from zfall.envs.terms.posture import reference_posture
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.rewards import WeightedReward


def build(make_base, terms):
    base = make_base(num_envs=3)
    return make_env(
        base,
        {
            "action": JointPositionTarget(base, scale=1.0),
            "reward": WeightedReward(base, terms=terms),
        },
    )


def ones(td, next_td):
    return torch.ones(3, 1)


def world(td, next_td):
    return torch.arange(3.0)[:, None]


def test_reward_is_the_weighted_sum_and_keeps_its_summands(make_base):
    env = build(make_base, {"one": (2.0, ones), "two": (-0.5, world)})
    check_env_specs(env)
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    after = env.step(td)["next"]
    assert_close(after["reward"], torch.tensor([[2.0], [1.5], [1.0]]))
    assert_close(after["reward_terms", "one"], torch.full((3, 1), 2.0))
    assert_close(after["reward_terms", "two"], torch.tensor([[0.0], [-0.5], [-1.0]]))


def test_null_or_a_weight_of_null_leaves_a_term_out(make_base):
    env = build(make_base, {"one": (2.0, ones), "two": (None, world), "three": None})
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    after = env.step(td)["next"]
    assert_close(after["reward"], torch.full((3, 1), 2.0))
    assert list(after["reward_terms"].keys()) == ["one"]


def test_term_that_asks_for_the_robot_gets_it(make_base):
    env = build(make_base, {"posture": (1.0, partial(reference_posture, sigma=1.0))})
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    reward = env.step(td)["next", "reward"]
    assert (reward > 0.98).all()  # it stands in the reference pose, but for its own weight


def test_term_that_asks_for_the_ranges_of_the_joints_gets_them_unless_it_has_some(make_base):
    narrow = torch.zeros(20, 2)
    terms = {
        "its": (1.0, joint_limits),
        "mine": (1.0, partial(joint_limits, joint_range=narrow)),
    }
    env = build(make_base, terms)
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    after = env.step(td)["next"]
    assert_close(after["reward_terms", "its"], torch.zeros(3, 1))
    size = after["joint_position"].abs().sum(-1, keepdim=True)
    assert_close(after["reward_terms", "mine"], size)


def test_table_without_a_term_is_refused(make_base):
    with pytest.raises(ValueError, match="at least one term"):
        WeightedReward(make_base(), terms={"one": (None, ones)})


def row(td, next_td):
    return torch.ones(3)


def elsewhere(td, next_td):
    return next_td["joint_vel"]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (ones, r"terms.mine must be \[weight, function\], got <function"),
        ((1.0, 2.0), r"terms.mine must be \[weight, function\]"),
        (("x", ones), "terms.mine must have a number as its weight, got x"),
    ],
)
def test_entries_that_are_no_terms_are_refused(make_base, entry, message):
    with pytest.raises(ValueError, match=message):
        build(make_base, {"mine": entry})


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (row, r"terms.mine must return \(3, 1\), one number per world, got \(3,\)"),
        (elsewhere, "terms.mine reads what is not there: .*joint_vel"),
    ],
)
def test_terms_that_go_wrong_are_named_at_the_first_step(make_base, term, message):
    env = build(make_base, {"mine": (1.0, term)})
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    with pytest.raises(ValueError, match=message):
        env.step(td)


@pytest.mark.parametrize(("value", "given"), [(torch.nan, "nan"), (-torch.inf, "-inf")])
def test_a_term_that_is_not_finite_is_named_in_the_step_and_with_the_world(make_base, value, given):
    def spoilt(td, next_td):
        return torch.where(torch.arange(3)[:, None] == 1, value, next_td["base_position"][:, :1])

    env = build(make_base, {"mine": (0.5, spoilt)})
    with pytest.raises(ValueError, match=rf"terms.mine must be finite, got {given} in world 1"):
        env.step(env.reset().set("action", torch.zeros(3, 20)))


def test_large_terms_are_no_fault(make_base):
    env = build(make_base, {"mine": (1.0, lambda td, next_td: torch.full((3, 1), 3e38))})
    after = env.step(env.reset().set("action", torch.zeros(3, 20)))["next"]
    assert not after["diverged"].any()
