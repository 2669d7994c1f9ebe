"""Averages over the recent past against the closed form, and against SciPy's filter."""

import math

import pytest
import torch
from scipy.signal import lfilter
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import MovingAverage

KEYS = {"joint_torque": "mean_joint_torque"}


def test_a_step_is_approached_exponentially(make_base, play):
    """By 1 - 1/e within ``seconds``, ten steps of 0.04 s."""
    frames = [{"joint_torque": torch.zeros(1, 20)}, *[{"joint_torque": torch.ones(1, 20)}] * 10]
    out = play(MovingAverage(make_base(num_envs=1), keys=KEYS, seconds=0.4), frames)
    assert out[10]["mean_joint_torque"][0, 3].item() == pytest.approx(1 - math.exp(-1), abs=1e-6)


def test_it_is_a_filter_of_first_order_that_begins_anew_at_a_reset(make_base, play):
    torch.manual_seed(1)
    torque, a = torch.randn(30, 2, 20), math.exp(-0.04 / 0.3)
    resets = {12: torch.tensor([True, False])}
    frames = [{"joint_torque": each} for each in torque]
    out = play(MovingAverage(make_base(num_envs=2), keys=KEYS, seconds=0.3), frames, resets)
    found = torch.stack([td["mean_joint_torque"] for td in out]).double()
    for world, begin in ((0, 12), (1, 0)):
        x = torque[begin:, world].double().numpy()
        expected, _ = lfilter([1 - a], [1, -a], x, axis=0, zi=a * x[:1])
        torch.testing.assert_close(
            found[begin:, world], torch.from_numpy(expected), atol=1e-5, rtol=0
        )


def test_specs_hold(make_task):
    env = make_task({
        "action": (JointPositionTarget, {"scale": 0.6}),
        "load": (MovingAverage, {"keys": KEYS, "seconds": 1.0}),
    })  # fmt: skip
    check_env_specs(env)


def test_bad_values_are_refused(make_base):
    with pytest.raises(ValueError, match="at least one quantity"):
        MovingAverage(make_base(), keys={}, seconds=1.0)
    with pytest.raises(ValueError, match="numbers of the base env, got torque"):
        MovingAverage(make_base(), keys={"torque": "load"}, seconds=1.0)
    with pytest.raises(ValueError, match="numbers of the base env, got feet_contact"):
        MovingAverage(make_base(), keys={"feet_contact": "contact"}, seconds=1.0)
    with pytest.raises(ValueError, match="names of their own, base_position is taken"):
        MovingAverage(make_base(), keys={"joint_torque": "base_position"}, seconds=1.0)
    with pytest.raises(ValueError, match="positive and finite, got 0"):
        MovingAverage(make_base(), keys=KEYS, seconds=0.0)
