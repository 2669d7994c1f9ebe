"""When episodes end, and how."""

from functools import partial

import pytest
import torch
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.value import GAE

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.terminations import Terminations, time_limit


def build(make_base, conditions, seconds: float = 0.4, ends: bool = False):
    base = make_base(num_envs=3)
    return make_env(
        base,
        {
            "action": JointPositionTarget(base, scale=1.0),
            "end": Terminations(base, conditions=conditions),
            "limit": time_limit(base, seconds=seconds, ends=ends),
        },
    )


def second_world(td, next_td):
    return torch.tensor([[False], [True], [False]])


def test_condition_ends_its_world_for_good_and_says_which_it_was(make_base):
    env = build(make_base, {"mine": second_world, "off": None})
    check_env_specs(env)
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    after = env.step(td)["next"]
    for key in ("terminated", "done", ("terminations", "mine")):
        assert after[key].squeeze().tolist() == [False, True, False]
    assert not after["truncated"].any()
    assert list(after["terminations"].keys()) == ["mine"]


def test_a_time_limit_that_ends_leaves_no_value_behind_it(make_base):
    """Advantages of the last step are its reward less its value, whatever the value after it."""
    env = build(make_base, {}, seconds=0.1, ends=True)
    check_env_specs(env)
    steps = round(0.1 / env.base_env.control_dt)
    td = env.rollout(steps, break_when_any_done=False)
    assert td["next", "terminated"].squeeze(-1).sum(1).tolist() == [1, 1, 1]
    assert td["next", "terminated"][:, -1].all()
    assert not td["next", "truncated"].any()
    assert (td["next", "step_count"][:, -1] == steps).all()
    td["next", "reward"] = torch.ones(3, steps, 1)
    td["state_value"] = torch.full((3, steps, 1), 0.25)
    td["next", "state_value"] = torch.full((3, steps, 1), 40.0)
    td = GAE(gamma=0.9, lmbda=0.8, value_network=None, deactivate_vmap=True)(td)
    torch.testing.assert_close(td["advantage"][:, -1], torch.full((3, 1), 0.75))


def test_time_limit_truncates_after_its_seconds(make_base):
    env = build(make_base, {}, seconds=0.4)
    rollout = env.rollout(20)
    assert rollout.shape[1] == 10  # 0.4 s at 25 Hz
    assert rollout["next", "truncated"][:, -1].all()
    assert not rollout["next", "terminated"].any()


def test_collecting_goes_on_in_a_new_episode(make_base):
    env = build(make_base, {"mine": second_world})
    td = env.reset()
    td["action"] = torch.full((3, 20), 0.5)
    data, td = env.step_and_maybe_reset(td)
    assert data["next", "done"][1]
    assert not td["done"].any()
    assert td["step_count"].squeeze().tolist() == [1, 0, 1]


def test_limit_shorter_than_a_step_is_refused(make_base):
    with pytest.raises(ValueError, match=r"seconds must be at least control_dt 0.04, got 0.01"):
        time_limit(make_base(), seconds=0.01)


def wrong(td, next_td, *, kind):
    if kind == "key":
        return next_td["nothing"] > 0
    falls = torch.tensor([False, True, False])
    return falls if kind == "shape" else falls[:, None].float()


@pytest.mark.parametrize(("kind", "message"), [
    ("key", "conditions.mine reads what is not there: .*nothing"),
    ("shape", r"conditions.mine must return \(3, 1\) bool, one per world, got \(3,\) bool"),
    ("type", r"conditions.mine must return \(3, 1\) bool, one per world, got \(3, 1\) float32"),
])  # fmt: skip
def test_a_condition_that_gives_something_else_is_refused(make_base, kind, message):
    env = build(make_base, {"mine": partial(wrong, kind=kind)})
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    with pytest.raises(ValueError, match=message):
        env.step(td)


def test_a_condition_that_is_no_function_is_refused(make_base):
    with pytest.raises(ValueError, match="conditions.tilt must be a function or null, got 0.5"):
        Terminations(make_base(), conditions={"tilt": 0.5})
