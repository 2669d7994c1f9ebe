"""From action to target, and how late it arrives."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget


def test_target_is_reference_plus_scaled_action_within_the_ranges(make_task):
    env = make_task({"action": (JointPositionTarget, {"scale": 0.5})})
    check_env_specs(env)
    td = env.reset()
    base = env.base_env
    assert_close(td["target"], base.stand_position.expand(4, -1))
    td["action"] = torch.zeros(4, 20)
    td["action"][:, 3], td["action"][:, 9] = 0.2, 100.0
    target = env.step(td)["next", "target"][0]
    assert target[3].item() == pytest.approx(-0.8 + 0.1)  # right knee, bent by 0.8 in the reference
    assert target[9].item() == pytest.approx(1.396263)  # left knee, at its published stop
    assert_close(target[[0, 15]], torch.zeros(2))


def test_scale_must_be_positive(make_base):
    with pytest.raises(ValueError, match=r"scale must be positive, got 0"):
        JointPositionTarget(make_base(), scale=0)


def commands_seen(env, base, steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Commands given at each control step, and what the servos got at each physics step."""
    given, got = [], []
    inner = base._step
    base._step = lambda td: got.append(td["control"].clone()) or inner(td)
    td = env.reset()
    for step in range(steps):
        td["action"] = torch.full((base.num_envs, 20), 0.01 * (step + 1))
        given.append(td["action"][:, 0].clone())
        td = env.step(td)["next"]
    return torch.stack(given, 1), torch.cat(got, 1)


@pytest.mark.parametrize("delay_steps", [0, 1, 3, 9, 10, 11, 20, 25])
@pytest.mark.parametrize(
    ("control_dt", "physics_dt"), [(0.04, 0.004), (0.02, 0.004), (0.01, 0.005)]
)
def test_delay_is_exact_to_one_physics_step(make_task, control_dt, physics_dt, delay_steps):
    """The command of time t is first seen at t + delay, by cross-correlation in whole steps."""
    delay = delay_steps * physics_dt
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 1.0}),
            "delay": (ActuatorDelay, {"delay": (delay, delay), "max_delay": 0.2}),
        },
        num_envs=2, control_dt=control_dt, physics_dt=physics_dt,
    )  # fmt: skip
    base = env.base_env
    given, got = commands_seen(env, base, 16)
    substeps = base.substeps
    sent = torch.cat([torch.zeros(2, 1), given], 1)  # before the first command: the reference
    joint = 15  # at 0 in the reference, so that target = action
    for k in range(got.shape[1]):
        command = (k - delay_steps) // substeps + 1
        assert_close(got[:, k, joint], sent[:, max(command, 0)])


def test_delay_is_drawn_per_world_and_episode_over_its_whole_range(make_task):
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 1.0}),
            "delay": (ActuatorDelay, {"delay": (0.008, 0.024)}),
        },
        num_envs=256,
    )
    lag = env.transform[0].lag
    env.reset()
    first = env.transform[0].lag
    assert first.min() == 2
    assert first.max() == 6
    assert not torch.equal(first, lag)


def test_partial_reset_forgets_the_commands_of_its_rows_alone(make_task):
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 1.0}),
            "delay": (ActuatorDelay, {"delay": (0.04, 0.04)}),
        },
        num_envs=2,
    )
    got = []
    base, inner = env.base_env, env.base_env._step
    base._step = lambda td: got.append(td["control"].clone()) or inner(td)
    td = env.reset()
    td["action"] = torch.full((2, 20), 0.3)
    td = env.step(td)["next"]
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    td["action"] = torch.zeros(2, 20)
    env.step(td)
    assert_close(got[1][0, :, 15], torch.zeros(10))
    assert_close(got[1][1, :, 15], torch.full((10,), 0.3))


@pytest.mark.parametrize("delay", [(0.0, 0.2), (-0.01, 0.0), (0.05, 0.02)])
def test_delay_outside_the_buffer_is_refused(make_base, delay):
    with pytest.raises(ValueError, match=r"delay must be \[shortest, longest\] within"):
        ActuatorDelay(make_base(), delay=delay, max_delay=0.1)
