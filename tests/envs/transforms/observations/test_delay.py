"""How late measurements arrive."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import ObservationDelay, ObservationNoise
from zfall.simulation.quantities import SUBSTEP_KEYS

MEANS = ("base_acceleration", "joint_torque")  # over the step; the substeps hold single values
STATE_KEYS = [key for key in SUBSTEP_KEYS if key not in MEANS]


def delayed(make_base, values: dict, **kwargs):
    base = make_base(**kwargs)
    delay = ObservationDelay(base, **values)
    action = JointPositionTarget(base, scale=1.0)
    return make_env(base, {"action": action, "delay": delay}), delay


def course(env, key: str, steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    """What was measured at each control step ``(N, K, D)``, and the truth at each physics step."""
    true, got = [], []
    base = env.base_env
    inner = base._step

    def step(td):
        out = inner(td)
        true.append(out["substeps", key].clone())
        return out

    base._step = step
    td = env.reset()
    start = td[key].clone()
    for _ in range(steps):
        td["action"] = 0.5 * torch.randn(base.num_envs, 20)
        td = env.step(td)["next"]
        got.append(td["measured", key].clone())
        assert_close(true[-1][:, -1], td[key], atol=0, rtol=0)
    return torch.stack(got, 1), torch.cat([start[:, None].expand(-1, 30, -1), *true], 1)


@pytest.mark.parametrize("control_dt", [0.04, 0.02, 0.01])
def test_delay_is_exact_to_one_physics_step_over_its_range(make_base, control_dt):
    """Cross-correlation of measured and true joint speeds, world i being i steps of 5 ms late."""
    values = {
        "delay": (0.0, 0.0),
        "max_delay": 0.1,
        "keys": ["joint_velocity", "projected_gravity"],
    }
    env, delay = delayed(make_base, values, num_envs=21, control_dt=control_dt, physics_dt=0.005)
    delay.delay = 0.005 * torch.arange(21).expand(2, -1)
    got, true = course(env, "joint_velocity", round(0.4 / control_dt))
    substeps = env.base_env.substeps
    ends = 29 + substeps * torch.arange(1, got.shape[1] + 1)  # 30 entries stand for the start
    for world in range(21):
        assert_close(got[world], true[world, ends - world], atol=0, rtol=0)
        earlier = torch.stack([true[world, ends - lag].flatten() for lag in range(25)])
        alike = torch.cosine_similarity(got[world].flatten(), earlier, dim=-1)
        assert alike.argmax() == world


def test_delay_of_each_step_is_drawn_anew_and_shared_by_the_group(make_base):
    values = {"delay": (0.0, 0.1), "per": "step", "keys": ["joint_velocity", "joint_position"]}
    env, delay = delayed(make_base, values, num_envs=8)
    lags = []
    inner = delay._deliver
    delay._deliver = lambda td: lags.append(delay.lag.clone()) or inner(td)
    got, true = course(env, "joint_velocity", 8)
    for step, lag in enumerate(lags[1:]):
        for world in range(8):
            place = 29 + 10 * (step + 1) - int(lag[world])
            assert torch.equal(got[world, step], true[world, place])
    assert len({tuple(lag.tolist()) for lag in lags[1:]}) == 8


def test_specs_hold_with_every_key_and_substeps_are_taken_out(make_base):
    base = make_base()
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "imu": ObservationDelay(base, delay=(0.0, 0.02), keys=["projected_gravity", "base_acceleration"]),
        "joints": ObservationDelay(base, delay=(0.0, 0.02), keys=["joint_position"]),
        "noise": ObservationNoise(base, std={"joint_position": 0.0}),
    })  # fmt: skip
    check_env_specs(env)
    td = env.rollout(3)
    assert "substeps" not in td.keys()
    assert "substeps" not in td["next"].keys()


def test_without_delay_every_key_of_the_state_is_measured_as_it_is(make_base):
    env, _ = delayed(make_base, {"delay": (0.0, 0.0), "keys": list(SUBSTEP_KEYS)})
    td = env.rollout(4)["next"]
    for key in STATE_KEYS:
        assert torch.equal(td["measured", key], td[key]), key
    mean, last = td["base_acceleration"], td["measured", "base_acceleration"]
    assert (mean - last).abs().max() > 0.01


def test_noise_acts_on_what_the_delay_delivers(make_base):
    base = make_base(num_envs=2)
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "delay": ObservationDelay(base, delay=(0.04, 0.04), keys=["joint_position"]),
        "noise": ObservationNoise(base, std={"joint_position": 1e-9}),
    })  # fmt: skip
    td = env.rollout(6)
    assert_close(td["next", "measured", "joint_position"], td["joint_position"])


def test_delay_after_another_sensing_transform_is_refused(make_base):
    base = make_base()
    table = {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std={"joint_position": 0.1}),
        "delay": ObservationDelay(base, delay=(0.0, 0.0), keys=["joint_position"]),
    }
    with pytest.raises(
        ValueError, match=r"keys must not be measured before .* got joint_position: put"
    ):
        make_env(base, table)


def test_partial_reset_forgets_the_past_of_its_rows_alone(make_base):
    env, delay = delayed(make_base, {"delay": (0.0, 0.08), "keys": ["joint_position"]}, num_envs=3)
    td = env.reset()
    for _ in range(4):
        td["action"] = torch.randn(3, 20)
        td = env.step(td)["next"]
    assert delay.slot > 0  # amid the ring
    seen, history = td["measured", "joint_position"].clone(), delay.history.clone()
    lag = delay.lag.clone()
    td["_reset"] = torch.tensor([[False], [True], [False]])
    td = env.reset(td)
    start = td["joint_position"][1]
    assert_close(start, env.base_env.stand_position)
    assert torch.equal(td["measured", "joint_position"][1], start)
    assert torch.equal(delay.history[1], start.expand_as(history[1]))
    assert torch.equal(td["measured", "joint_position"][[0, 2]], seen[[0, 2]])
    assert torch.equal(delay.history[[0, 2]], history[[0, 2]])
    assert torch.equal(delay.lag[[0, 2]], lag[[0, 2]])


def test_world_that_diverged_shows_its_new_state_at_every_physics_step(make_base):
    base = make_base(num_envs=2)
    base.record_substeps(["joint_velocity"])
    td = base.reset(
        TensorDict({"start": {"joint_velocity": torch.tensor([[1e9], [0.0]]).expand(2, 20)}}, [2])
    )
    td["target"] = base.stand_position.expand(2, -1)
    out = base._step(td)
    assert out["diverged"][:, 0].tolist() == [True, False]
    assert_close(out["substeps", "joint_velocity"][0], torch.zeros(10, 20))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"keys": ["feet_force"]}, r"keys must be known at every physics step \(.*joint_position.*\), got feet_force"),
        ({"keys": []}, r"keys must name at least one quantity, got none"),
        ({"keys": ["joint_position"], "delay": (0.0, 0.5)}, r"delay must be .* got \[0.0, 0.5\] with max_delay 0.1"),
        ({"keys": ["joint_position"], "per": "joint"}, r"per must be episode or step, got 'joint'"),
    ],
)  # fmt: skip
def test_bad_value_is_refused_by_name_and_rule(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        ObservationDelay(make_base(), **{"delay": (0.0, 0.01), **values})
