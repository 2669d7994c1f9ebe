"""Pushes: impulses integrated, times counted."""

import math

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.pushes import RandomPush, ScriptedPush
from zfall.robots import ZEROTH01
from zfall.rotations import wrap

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}
RATES = [(0.04, 0.004), (0.02, 0.004), (0.035, 0.005), (0.01, 0.0025)]


def pushed(make_task, push: dict, *, kind=RandomPush, **kwargs):
    return make_task({**ACTION, "push": (kind, {"point": "torso"} | push)}, **kwargs)


def wrenches(env, seconds: float) -> torch.Tensor:
    """Wrench on every body at every physics step ``(N, T, bodies, 6)``."""
    seen = []
    base, inner = env.base_env, env.base_env._step
    base._step = lambda td: seen.append(td["push", "wrench"].float()) or inner(td)
    td = env.reset()
    for _ in range(round(seconds / base.control_dt)):
        td["action"] = torch.zeros(base.num_envs, 20)
        td = env.step(td)["next"]
    return torch.cat(seen, 1)


@pytest.mark.parametrize(("control_dt", "physics_dt"), RATES)
def test_wrench_integrates_to_the_impulse_asked(make_task, control_dt, physics_dt):
    """One push in 0.7 s: it starts after 0.3-0.5 s, lasts 0.1 s, and rests 0.3 s at least."""
    push = {"impulse": (1.5, 1.5), "duration": 0.1, "interval": (0.3, 0.5)}
    env = pushed(make_task, push, num_envs=16, control_dt=control_dt, physics_dt=physics_dt)
    total = wrenches(env, 0.7).sum((1, 2)) * physics_dt
    assert_close(total[:, :3].norm(dim=-1), torch.full((16,), 1.5), rtol=1e-5, atol=0)
    assert_close(total[:, 2:], torch.zeros(16, 4))


@pytest.mark.parametrize(("control_dt", "physics_dt"), RATES)
def test_scripted_push_begins_and_ends_when_told(make_task, control_dt, physics_dt):
    push = {
        "duration": 0.1,
        "time": torch.full((2,), 0.21),
        "plan": torch.tensor([[10.0, 0, 0], [0, 5.0, 0]]),
    }
    env = pushed(
        make_task, push, kind=ScriptedPush, num_envs=2, control_dt=control_dt, physics_dt=physics_dt
    )
    wrench = wrenches(env, 0.49)
    body = env.base_env.push_targets["torso"]
    begin = physics_dt * torch.arange(wrench.shape[1])
    inside = (begin >= 0.21 - 1e-6) & (begin + physics_dt <= 0.31 + 1e-6)
    outside = (begin + physics_dt <= 0.21 + 1e-6) | (begin >= 0.31 - 1e-6)
    assert_close(
        wrench[0, inside, body, 0], torch.full((int(inside.sum()),), 10.0), rtol=1e-4, atol=0
    )
    assert wrench[:, outside].abs().max() < 1e-3
    assert_close(wrench[1, :, body, 1].sum() * physics_dt, torch.tensor(0.5), rtol=1e-5, atol=0)


def test_momentum_gained_is_the_impulse_asked(make_task):
    """In the air, without gravity's share: p = J after the push."""
    push = {
        "duration": 0.1,
        "time": torch.full((1,), 0.05),
        "plan": torch.tensor([[8.0, 6.0, 0.0]]),
    }
    env = pushed(make_task, push, kind=ScriptedPush, num_envs=1, control_dt=0.02)
    base = env.base_env
    base.simulation.model.opt.gravity[:] = 0
    td = env.reset()
    base.simulation.qpos[:, 2] = 2.0
    for _ in range(15):
        td["action"] = torch.zeros(1, 20)
        td = env.step(td)["next"]
    assert_close(td["linear_momentum"], torch.tensor([[0.8, 0.6, 0.0]]), atol=0.03, rtol=0)


@pytest.mark.parametrize(("given", "newton"), [
    ({"force": (12.0, 12.0)}, 12.0),
    ({"impulse": (1.2, 1.2)}, 12.0),
    ({"size": (0.5, 0.5)}, 0.5 * 3.3494 * (9.81 * 0.220) ** 0.5 / 0.1),
])  # fmt: skip
def test_force_impulse_and_dimensionless_size_mean_the_same_push(make_task, given, newton):
    env = pushed(make_task, given | {"duration": 0.1, "interval": (0.1, 0.2)})
    force = wrenches(env, 0.6)[..., :2].norm(dim=-1).amax((1, 2))
    assert_close(force, torch.full((4,), newton), rtol=1e-4, atol=0)


def test_push_point_off_the_center_of_mass_turns_the_body_and_rides_on_it(make_task):
    """At the elbow the force acts on a massless body at the joint, which MuJoCo makes exact."""
    env = pushed(
        make_task, {"point": "elbow", "force": (5.0, 5.0), "duration": 0.1, "interval": (0.1, 0.1)}
    )
    wrench = wrenches(env, 0.4)
    acting = wrench.abs().amax((0, 1, 3)).nonzero().squeeze(-1)
    name = env.base_env.simulation.model.body(int(acting) + 1).name
    assert name == "push_point/elbow"


def test_push_off_the_center_of_mass_gives_the_angular_momentum_of_its_lever(make_task):
    """In the air without gravity, L = r x J about the center of mass, r to the push point."""
    plan = torch.tensor([[0.0, 6.0, 0.0]])
    push = {"point": "chest", "duration": 0.02, "time": torch.full((1,), 0.02), "plan": plan}
    env = pushed(make_task, push, kind=ScriptedPush, num_envs=1, control_dt=0.02, physics_dt=0.001)
    base = env.base_env
    base.simulation.model.opt.gravity[:] = 0
    base.simulation.model.dof_damping[6:] = (
        1e4  # one rigid body: armature holds momentum of its own
    )
    td = env.reset()
    base.simulation.qpos[:, 2] = 2.0
    for _ in range(3):
        td["action"] = torch.zeros(1, 20)
        td = env.step(td)["next"]
    lever = td["base_position"] + torch.tensor([[0.0, 0.0, 0.026]]) - td["com_position"]
    expected = torch.linalg.cross(lever, 0.02 * plan)
    assert expected[0, 0].abs() > 0.01  # a lever of 0.14 m
    assert_close(td["angular_momentum"], expected, atol=0.04 * expected.norm().item(), rtol=0)


def test_no_push_comes_right_after_a_reset(make_task):
    env = pushed(
        make_task, {"force": (5.0, 5.0), "duration": 0.1, "interval": (0.2, 0.4)}, num_envs=64
    )
    assert wrenches(env, 0.2).abs().max() == 0
    td = env.reset()
    for _ in range(12):
        td["action"] = torch.zeros(64, 20)
        td = env.step(td)["next"]
    td["_reset"] = torch.ones(64, 1, dtype=torch.bool)
    td = env.reset(td)
    assert td["push", "force"].abs().max() == 0
    for _ in range(5):
        td["action"] = torch.zeros(64, 20)
        td = env.step(td)["next"]
        assert td["push", "force"].abs().max() == 0


def test_rests_between_pushes_lie_in_the_interval(make_task):
    env = pushed(
        make_task, {"force": (5.0, 5.0), "duration": 0.02, "interval": (0.1, 0.3)}, num_envs=32
    )
    active = wrenches(env, 4.0).abs().amax((2, 3)) > 0
    edges = active.int().diff(dim=1)
    for world in range(32):
        begins, ends = (edges[world] == 1).nonzero(), (edges[world] == -1).nonzero()
        rests = 0.004 * (begins[1:] - ends[: len(begins) - 1]).float()
        assert rests.min() > 0.1 - 0.009
        assert rests.max() < 0.3 + 0.009


def test_headings_cover_the_circle_and_pushes_stay_level(make_task):
    env = pushed(
        make_task, {"force": (5.0, 5.0), "duration": 0.05, "interval": (0.0, 0.1)}, num_envs=256
    )
    force = wrenches(env, 0.2).sum((1, 2))
    assert force[:, 2].abs().max() == 0
    quadrant = (force[:, 0] > 0).int() + 2 * (force[:, 1] > 0).int()
    counts = quadrant.bincount(minlength=4)
    assert counts.min() > 256 / 4 - 5 * (256 * 3 / 16) ** 0.5  # five sigma


def test_each_world_is_pushed_from_its_own_part_of_the_circle(make_task):
    """Four parts: forward, left, backward and right, each 90 degrees wide and filled."""
    env = pushed(
        make_task,
        {"force": (5.0, 5.0), "duration": 0.05, "interval": (0.0, 0.1), "sectors": 4},
        num_envs=256,
    )
    force = wrenches(env, 0.2).sum((1, 2))
    middle = torch.arange(256) % 4 * math.pi / 2
    away = wrap(torch.atan2(force[:, 1], force[:, 0]) - middle)
    assert away.abs().max() < math.pi / 4 + 1e-5
    for part in range(4):  # uniform: five sigma of the mean of 64
        assert abs(away[part::4].mean()) < 5 * (math.pi / 2) / (12 * 64) ** 0.5
        assert away[part::4].std() == pytest.approx((math.pi / 2) / 12**0.5, rel=0.25)


def test_partial_reset_redraws_only_its_rows(make_task):
    env = pushed(
        make_task, {"force": (1.0, 9.0), "duration": 0.1, "interval": (1.0, 2.0)}, num_envs=8
    )
    td = env.reset()
    before = env.transform[0].force_now.clone()
    rows = torch.arange(8)[:, None] < 3
    td["_reset"] = rows
    env.reset(td)
    changed = (env.transform[0].force_now != before).any(-1)
    assert changed.tolist() == rows.squeeze().tolist()


def test_two_pushes_add_up(make_task):
    first = {"point": "torso", "force": (3.0, 3.0), "duration": 0.1, "interval": (0.1, 0.1)}
    env = make_task(
        {**ACTION, "a": (RandomPush, first), "b": (RandomPush, first | {"point": "Left_Foot"})}
    )
    total = wrenches(env, 0.28)[..., :3].norm(dim=-1).sum((1, 2)) * 0.004
    assert_close(total, torch.full((4,), 0.6), rtol=1e-4, atol=0)


def test_pushes_begin_at_the_times_given_and_keep_their_size(make_task):
    push = {"times": [0.05, 0.33, 0.71], "impulse": (0.6, 0.6), "duration": 0.1}
    env = pushed(make_task, push | {"direction": [0, 1, 0]})
    force = wrenches(env, 1.0)[:, :, env.base_env.push_targets["torso"], 1]
    for start in (0.05, 0.33, 0.71):
        steps = slice(round(start / 0.004) - 3, round((start + 0.1) / 0.004) + 3)
        assert_close(0.004 * force[:, steps].sum(1), torch.full((4,), 0.6), rtol=1e-4, atol=0)
        first = (force[0] > 0).nonzero()[:, 0] * 0.004
        assert (first[first > start - 0.03][0] - start).abs() < 0.0041
    assert_close(0.004 * force.sum(1), torch.full((4,), 1.8), rtol=1e-4, atol=0)


@pytest.mark.parametrize("profile", ["half_sine", "gaussian", "ramp"])
def test_every_profile_gives_the_impulse_asked(make_task, profile):
    push = {"impulse": (1.5, 1.5), "duration": 0.13, "times": [0.1], "profile": profile}
    total = wrenches(pushed(make_task, push, control_dt=0.02), 0.4).sum((1, 2)) * 0.004
    assert_close(total[:, :3].norm(dim=-1), torch.full((4,), 1.5), rtol=1e-5, atol=0)


def test_each_axis_has_a_range_of_its_own(make_task):
    axes = {"x": [-20, 20], "z": [5, 5]}
    env = pushed(make_task, {"axes": axes, "duration": 0.1, "times": [0.0]}, num_envs=128)
    force = wrenches(env, 0.08)[:, 5, env.base_env.push_targets["torso"], :3]
    assert force[:, 0].amin() < -15
    assert force[:, 0].amax() > 15
    assert force[:, 0].abs().amax() <= 20
    assert force[:, 1].abs().amax() == 0
    assert_close(force[:, 2], torch.full((128,), 5.0), rtol=1e-5, atol=0)


def test_a_push_takes_one_of_several_points(make_task):
    push = {"point": ["torso", "pelvis", "chest"], "force": (6.0, 6.0), "times": [0.0]}
    env = pushed(make_task, push | {"duration": 0.1}, num_envs=90)
    wrench = wrenches(env, 0.2)[..., :3].norm(dim=-1).sum(1) * 0.004
    targets = [env.base_env.push_targets[p] for p in ("torso", "pelvis", "chest")]
    acting = wrench[:, targets] > 0
    assert (acting.sum(1) == 1).all()
    assert_close(wrench.sum(1), torch.full((90,), 0.6), rtol=1e-4, atol=0)
    assert acting.sum(0).min() > 30 - 5 * (90 * 2 / 9) ** 0.5  # five sigma


def test_mean_time_from_push_to_push_is_the_one_asked(make_task):
    push = {"force": (1.0, 1.0), "duration": 0.1, "mean_interval": 0.5}
    env = pushed(make_task, push, num_envs=64)
    active = wrenches(env, 6.0)[..., :3].abs().amax((2, 3)) > 0
    count = (active.int().diff(dim=1) == 1).sum().item()
    expected = 64 * 6.0 / 0.5
    # Exponential rests of 0.4 s, of which what falls into a running control step waits for its end.
    assert count == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(("values", "message"), [
    ({"point": "tail"}, r"point must be a push point or a link, one of elbow, torso, pelvis.*got 'tail'"),
    ({"duration": 0.0}, r"duration must be positive, got \[0.0, 0.0\]"),
    ({"interval": (2.0, 1.0)}, r"interval must be \[smallest, largest\], got \[2.0, 1.0\]"),
    ({"size": (0.1, 0.2)}, "give just one of force, impulse, size, axes, got force, size"),
    ({"sectors": 4, "direction": "spherical"}, "sectors must be null, or 1 and more for planar"),
    ({"sectors": 0}, "sectors must be null, or 1 and more for planar directions, got 0"),
    ({"force": None}, "give just one of force, impulse, size, axes, got none"),
])  # fmt: skip
def test_bad_values_are_refused(make_base, values, message):
    good = {"point": "torso", "force": (1.0, 2.0), "duration": 0.1, "interval": (1.0, 2.0)}
    with pytest.raises(ValueError, match=message):
        RandomPush(make_base(), **(good | values))


def test_impulse_unit_scales_as_the_laws_of_the_docs():
    assert ZEROTH01.impulse_unit / 0.1 == pytest.approx(49.2, abs=0.05)  # I = 1 in N for 0.1 s
