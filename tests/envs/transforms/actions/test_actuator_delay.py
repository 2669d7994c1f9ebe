"""How late commands arrive."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget, LowPass


def seen(env, steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Commands given and what the servos got, at every physics step ``(N, K)``, for one joint."""
    given, got = [], []
    base = env.base_env
    inner = base._step
    base._step = lambda td: got.append(td["control"][..., 15].clone()) or inner(td)
    td = env.reset()
    for _ in range(steps):
        td["action"] = 0.1 * torch.randn(base.num_envs, 20)
        given.append(td["action"][:, 15].clone())  # at 0 in the reference: target = action
        td = env.step(td)["next"]
    return torch.stack(given, 1).repeat_interleave(base.substeps, 1), torch.cat(got, 1)


@pytest.mark.parametrize("joints", ["shared", "own"])
@pytest.mark.parametrize("control_dt", [0.04, 0.02, 0.01])
def test_delay_is_exact_to_one_physics_step_over_its_range(make_task, control_dt, joints):
    """Cross-correlation of command and effect, world i being i physics steps of 5 ms late."""
    values = {"delay": (0.0, 0.0), "max_delay": 0.1, "joints": joints}
    env = make_task(
        {"action": (JointPositionTarget, {"scale": 1.0}), "delay": (ActuatorDelay, values)},
        num_envs=21, control_dt=control_dt, physics_dt=0.005,
    )  # fmt: skip
    env.transform[0].delay = 0.005 * torch.arange(21).expand(2, -1)
    given, got = seen(env, round(0.6 / control_dt))
    for world in range(21):
        earlier = torch.stack([given[world, 30 - lag : -1 - lag] for lag in range(25)])
        alike = torch.cosine_similarity(got[world, 30:-1], earlier, dim=-1)
        assert alike.argmax() == world
        assert_close(got[world, world:], given[world, : given.shape[1] - world])
        assert_close(got[world, :world], torch.zeros(world))  # the reference, before the first


def test_servos_hold_the_joints_where_they_start_until_the_first_command_arrives(
    make_base, at_rest
):
    base = make_base(num_envs=2)
    transform = ActuatorDelay(base, delay=(0.012, 0.012))  # 3 of the 10 physics steps
    start = at_rest(base)
    start["joint_position"] = start["joint_position"] + torch.tensor([[0.1], [-0.1]])
    transform._reset(TensorDict(batch_size=[2]), start)
    command = TensorDict({"target": torch.full((2, 20), 0.7)}, [2])
    got = transform._inv_call(command)["control"]
    assert_close(got[:, :3], start["joint_position"][:, None].expand(-1, 3, -1))
    assert_close(got[:, 3:], torch.full((2, 7, 20), 0.7))


@pytest.mark.parametrize("joints", ["shared", "own"])
@pytest.mark.parametrize("per", ["episode", "step"])
def test_commands_are_those_of_a_queue_for_every_joint(make_base, per, joints, at_rest):
    base = make_base(num_envs=3)
    transform = ActuatorDelay(base, delay=(0.0, 0.06), per=per, joints=joints)
    transform._reset(TensorDict(batch_size=[3]), at_rest(base))
    sent, lags = [], []
    for step in range(8):
        commands = torch.randn(3, 10, 20)
        sent += commands.unbind(1)
        got = transform._inv_call(TensorDict({"control": commands}, [3]))["control"]
        lags.append(transform.lag.view(3, -1).expand(3, 20).clone())
        for substep in range(10):
            for world, joint in ((0, 0), (1, 7), (2, 19), (2, 3)):
                place = 10 * step + substep - int(lags[-1][world, joint])
                queue = base.stand_position if place < 0 else sent[place][world]
                assert got[world, substep, joint] == queue[joint]
    drawn = torch.stack(lags)
    assert (drawn != drawn[:1]).any() == (per == "step")
    assert (drawn != drawn[..., :1]).any() == (joints == "own")


def test_delay_is_drawn_per_world_and_episode_over_its_whole_range(make_task):
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 1.0}),
            "delay": (ActuatorDelay, {"delay": (0.008, 0.024)}),
        },
        num_envs=256,
    )
    env.reset()
    first = env.transform[0].lag.clone()
    assert first.min() == 2
    assert first.max() == 6
    env.reset()
    assert not torch.equal(first, env.transform[0].lag)


def test_partial_reset_draws_new_delays_for_its_rows_alone(make_base, at_rest):
    base = make_base(num_envs=64)
    transform = ActuatorDelay(base, delay=(0.0, 0.1))
    transform._reset(TensorDict(batch_size=[64]), at_rest(base))
    before = transform.lag.clone()
    rows = torch.arange(64)[:, None] < 32
    transform._reset(TensorDict({"_reset": rows}, [64]), at_rest(base))
    assert torch.equal(transform.lag[32:], before[32:])
    assert (transform.lag[:32] != before[:32]).sum() > 20


@pytest.mark.parametrize("before", [1, 4, 5])
def test_world_reset_amid_the_ring_waits_anew_and_the_other_goes_on(
    make_base, send, at_rest, before
):
    """Commands late by 25 physics steps; after ``before`` control steps of 10 one world resets."""
    base = make_base(num_envs=2)
    transform = ActuatorDelay(base, delay=(0.1, 0.1))
    transform._reset(TensorDict(batch_size=[2]), at_rest(base))
    commands = torch.randn(2, 120, 20)
    send(transform, commands[:, : 10 * before])
    transform._reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]), at_rest(base))
    out = send(transform, commands[:, 10 * before :])
    late = 10 * before - 25  # of which command the first one after the reset is
    waiting = base.stand_position.expand(25, 20)
    assert torch.equal(out[0, :25], waiting)
    assert torch.equal(out[0, 25:], commands[0, 10 * before : -25])
    rest = torch.cat([waiting[: max(0, -late)], commands[1, max(0, late) : -25]])
    assert torch.equal(out[1], rest)


def test_delay_and_filter_may_stand_in_any_order(make_base, send, at_rest):
    """Both are linear and do not change with time, so that they commute."""
    base = make_base()
    commands = base.stand_position + torch.randn(4, 60, 20)
    results = []
    for order in (0, 1):
        chain = [ActuatorDelay(base, delay=(0.028, 0.028)), LowPass(base, time_constant=0.03)]
        out = commands
        for transform in chain if order else reversed(chain):
            transform._reset(TensorDict(batch_size=[4]), at_rest(base))
            out = send(transform, out)
        results.append(out)
    assert_close(results[0], results[1], atol=1e-5, rtol=0)


@pytest.mark.parametrize("delay", [(0.0, 0.2), (-0.01, 0.0), (0.05, 0.02)])
def test_delay_outside_the_buffer_is_refused(make_base, delay):
    with pytest.raises(ValueError, match=r"delay must be \[shortest, longest\] within"):
        ActuatorDelay(make_base(), delay=delay, max_delay=0.1)


def test_delay_set_beyond_the_buffer_later_is_refused(make_base, at_rest):
    base = make_base()
    transform = ActuatorDelay(base, delay=(0.0, 0.0), max_delay=0.02)
    transform.delay = (0.03, 0.03)
    with pytest.raises(ValueError, match=r"delay must stay within \[0, max_delay\], got \[0.03"):
        transform._reset(TensorDict(batch_size=[4]), at_rest(base))


def test_the_delay_in_force_is_shown(make_task):
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 0.6}),
            "delay": (ActuatorDelay, {"delay": [0.0, 0.03], "param": "latency"}),
        },
        num_envs=64,
    )
    shown = env.rollout(3)["next", "params", "latency"]
    delay = next(t for t in env.transform if isinstance(t, ActuatorDelay))
    assert shown.shape == (64, 3, 1)
    assert_close(shown, (0.004 * delay.lag)[:, None, None].expand_as(shown))
    assert shown.max() > 0.02


def test_delays_of_single_joints_are_not_shown(make_base):
    with pytest.raises(ValueError, match="param must be null where each joint .*got late"):
        ActuatorDelay(make_base(), delay=[0.0, 0.03], joints="own", param="late")
