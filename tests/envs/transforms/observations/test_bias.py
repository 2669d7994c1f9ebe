"""Constant and wandering errors."""

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.transforms.observations import ObservationBias, ObservationRandomWalk

ZERO = torch.zeros(512, 20)


def test_bias_has_its_deviation_and_stays_for_the_episode(make_base, measure):
    base = make_base(num_envs=512)
    bias = ObservationBias(base, std={"joint_position": 0.03}, uniform={"joint_velocity": 0.2})
    values = {"joint_position": ZERO, "joint_velocity": ZERO}
    first = measure(bias, reset=True, **values)
    assert first.std().item() == pytest.approx(0.03, rel=0.05)  # 10240 draws: 7 sigma
    assert abs(first.mean().item()) < 5 * 0.03 / 10240**0.5
    for _ in range(3):
        assert torch.equal(measure(bias, **values), first)
    other = bias.bias_joint_velocity
    assert other.abs().max() <= 0.2
    assert other.std().item() == pytest.approx(0.2 / 3**0.5, rel=0.05)


def test_bias_is_drawn_anew_for_the_rows_of_a_reset_alone(make_base, measure):
    bias = ObservationBias(make_base(num_envs=512), std={"joint_position": 0.03})
    first = measure(bias, reset=True, joint_position=ZERO)
    rows = torch.arange(512)[:, None] % 2 == 0
    measure(bias, reset=True, rows=rows, joint_position=ZERO)
    second = measure(bias, joint_position=ZERO)
    assert torch.equal(second[1::2], first[1::2])
    assert (second[::2] != first[::2]).all()


@pytest.mark.parametrize("control_dt", [0.04, 0.01])
def test_variance_of_the_walk_grows_as_rate_squared_times_time(make_base, measure, control_dt):
    base = make_base(num_envs=512, control_dt=control_dt, physics_dt=0.005)
    walk = ObservationRandomWalk(base, rate={"joint_position": 0.1})
    assert torch.equal(measure(walk, reset=True, joint_position=ZERO), ZERO)
    for step in range(1, round(0.4 / control_dt) + 1):
        drift = measure(walk, joint_position=ZERO)
        expected = 0.1**2 * step * control_dt
        assert drift.var().item() == pytest.approx(expected, rel=0.08)  # 10240 draws: 5.7 sigma


def test_walk_starts_at_zero_in_the_rows_of_a_reset_alone(make_base, measure):
    walk = ObservationRandomWalk(make_base(num_envs=512), rate={"joint_position": 0.1})
    measure(walk, reset=True, joint_position=ZERO)
    before = measure(walk, joint_position=ZERO)
    rows = torch.arange(512)[:, None] % 2 == 0
    after = measure(walk, reset=True, rows=rows, joint_position=ZERO)
    assert torch.equal(after[::2], ZERO[::2])
    assert torch.equal(after[1::2], before[1::2])


@pytest.mark.parametrize(
    ("cls", "values", "message"),
    [
        (ObservationBias, {"std": {"joint_position": -1.0}}, r"std.joint_position must not be neg.* got -1.0"),
        (ObservationBias, {}, r"std or uniform must name at least one key, got none"),
        (ObservationBias, {"uniform": {"target": 1.0}}, r"uniform must name quantities of the base env \(.*joint_position.*\), got target"),
        (ObservationRandomWalk, {"rate": {"joint_position": -1.0}}, r"rate.joint_position must not be negative"),
        (ObservationRandomWalk, {"rate": {"gyro": 1.0}}, r"rate must name quantities .* got gyro"),
    ],
)  # fmt: skip
def test_bad_value_is_refused_by_name_and_rule(make_base, cls, values, message):
    with pytest.raises(ValueError, match=message):
        cls(make_base(), **values)


def test_bias_and_walk_of_each_world_act_there(make_base, measure):
    base = make_base(num_envs=2)
    bias = ObservationBias(base, std={"joint_position": 0.0})
    bias.std["joint_position"] = torch.tensor([0.0, 1.0])
    walk = ObservationRandomWalk(base, rate={"joint_position": 0.0})
    walk.rate["joint_position"] = torch.tensor([0.0, 1.0])
    for transform in (bias, walk):
        measure(transform, reset=True, joint_position=ZERO[:2])
        error = measure(transform, joint_position=ZERO[:2])
        assert_close(error[0], torch.zeros(20))
        assert (error[1] != 0).all()
