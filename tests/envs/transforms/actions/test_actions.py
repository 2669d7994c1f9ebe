"""What all transforms between the action and the servos have in common."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import (
    ActuatorDelay,
    Backlash,
    Deadband,
    JointPositionTarget,
    JointVelocityTarget,
    LowPass,
    ServoPlanner,
)

LOW_LEVEL = [
    (ActuatorDelay, {"delay": (0.012, 0.012)}),
    (ActuatorDelay, {"delay": (0.06, 0.06), "joints": "own"}),
    (ActuatorDelay, {"delay": (0.012, 0.012), "per": "step"}),
    (LowPass, {"time_constant": 0.05}),
    (ServoPlanner, {}),
    (Backlash, {"width": 0.1}),
    (Deadband, {"width": 0.1}),
]


@pytest.mark.parametrize(
    "first", [(JointPositionTarget, {"scale": 0.5}), (JointVelocityTarget, {"limit": 3.0})]
)
def test_all_of_them_in_a_row_hold_their_specs(make_task, first):
    more = {f"more{i}": transform for i, transform in enumerate(LOW_LEVEL)}
    env = make_task({"action": first, **more})
    check_env_specs(env)
    assert list(env.full_action_spec.keys()) == ["action"]


@pytest.mark.parametrize(("cls", "values"), LOW_LEVEL)
def test_partial_reset_equals_a_full_one_on_its_rows_and_none_on_the_others(
    make_base, send, cls, values, at_rest
):
    base = make_base()
    before, after = base.stand_position + 0.3 * torch.randn(2, 4, 40, 20)
    rows = torch.tensor([[True], [False], [True], [False]])
    results = {}
    for name, reset in {
        "part": rows,
        "full": torch.ones(4, 1, dtype=torch.bool),
        "none": None,
    }.items():
        transform = cls(base, **values)
        transform._reset(TensorDict(batch_size=[4]), at_rest(base))
        send(transform, before)
        if reset is not None:
            td = TensorDict({"_reset": reset}, [4])
            transform._reset(td, at_rest(base))
        results[name] = send(transform, after)
    expected = torch.where(rows[..., None], results["full"], results["none"])
    assert_close(results["part"], expected, atol=0, rtol=0)
    assert not torch.equal(results["full"], results["none"])


@pytest.mark.parametrize(("cls", "values"), LOW_LEVEL)
def test_saved_state_goes_on_in_the_same_way(make_base, send, cls, values, at_rest):
    base = make_base()
    before, after = base.stand_position + 0.3 * torch.randn(2, 4, 40, 20)
    one, other = cls(base, **values), cls(base, **values)
    one._reset(TensorDict(batch_size=[4]), at_rest(base))
    send(one, before)
    other.load_state_dict(one.state_dict())
    assert torch.equal(send(one, after), send(other, after))


@pytest.mark.parametrize(("cls", "values"), LOW_LEVEL)
def test_target_is_held_where_no_command_was_written(make_base, cls, values, at_rest):
    base = make_base()
    one, other = cls(base, **values), cls(base, **values)
    for transform in (one, other):
        transform._reset(TensorDict(batch_size=[4]), at_rest(base))
    for _ in range(3):
        target = base.stand_position + torch.randn(4, 20)
        held = one._inv_call(TensorDict({"target": target}, [4]))
        control = target[:, None].expand(-1, 10, -1)
        given = other._inv_call(TensorDict({"target": target, "control": control}, [4]))
        assert torch.equal(held["control"], given["control"])


@pytest.mark.parametrize(("cls", "values"), LOW_LEVEL)
def test_an_episode_begins_where_the_joints_are(make_base, send, cls, values):
    """Commands that say so from its first step on come out as they are: nothing was elsewhere."""
    base = make_base()
    places = base.stand_position + 0.3 * torch.randn(4, 20)
    transform = cls(base, **values)
    reset = TensorDict({"joint_position": places}, [4])
    transform._reset(TensorDict(batch_size=[4]), reset)
    commands = places[:, None].expand(-1, 20, -1)
    assert_close(send(transform, commands), commands)


@pytest.mark.parametrize(
    ("cls", "values", "name"),
    [
        (LowPass, {"time_constant": 0.05}, "time_constant"),
        (ServoPlanner, {}, "velocity"),
        (ServoPlanner, {}, "acceleration"),
        (Backlash, {"width": 0.1}, "width"),
        (Deadband, {"width": 0.1}, "width"),
    ],
)
def test_a_value_for_each_world_acts_there(make_base, send, cls, values, name):
    base = make_base()
    commands = base.stand_position + 0.3 * torch.randn(4, 40, 20)
    nominal = getattr(cls(base, **values), name)
    each = nominal * torch.tensor([1.0, 0.5, 2.0, 3.0])
    together = cls(base, **values)
    setattr(together, name, each)
    got = send(together, commands)
    for world, value in enumerate(each.tolist()):
        alone = cls(base, **{**values, name: value})
        assert_close(got[world], send(alone, commands)[world])


@pytest.mark.parametrize(
    ("cls", "values", "message"),
    [
        (LowPass, {"time_constant": 0.0}, r"time_constant must be positive, got 0.0"),
        (ServoPlanner, {"velocity": -1.0}, r"velocity must be positive, got -1.0"),
        (ServoPlanner, {"acceleration": -1.0}, r"acceleration must be positive, or 0 .*got -1.0"),
        (Backlash, {"width": -0.1}, r"width must not be negative, got -0.1"),
        (Deadband, {"width": -0.1}, r"width must not be negative, got -0.1"),
        (JointVelocityTarget, {"limit": 0.0}, r"limit must be positive, got 0.0"),
        (
            JointVelocityTarget,
            {"limit": 3.0, "rate": 100.0},
            r"rate must divide .* one of 250, 125, 50, 25 with control_dt 0.04 and physics_dt 0.004; got 100",
        ),
        (
            ActuatorDelay,
            {"delay": (0.0, 0.01), "per": "day"},
            r"per must be episode or step, got 'day'",
        ),
        (
            ActuatorDelay,
            {"delay": (0.0, 0.01), "joints": "no"},
            r"joints must be shared or own, got 'no'",
        ),
    ],
)
def test_bad_value_is_refused_by_name_and_rule(make_base, cls, values, message):
    with pytest.raises(ValueError, match=message):
        cls(make_base(), **values)
