"""Stable kneels, triggers and impacts on made-up trials."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ended, moment
from tests.evaluation.test_metrics import record
from zfall.falling.kneeling import Kneeling

ALL = [True] * 3
FALLEN = ended(ALL)


def kneel(env, **values) -> TensorDict:
    """Three worlds; world 0 rests on its left knee."""
    force = torch.zeros(3, len(env.regions))
    force[0, env.regions.index("left_knee")] = 10.0
    return record(len(env.regions), contact_force_peak=force, **values)


def test_a_kneel_is_stable_after_half_a_second_of_rest(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    steps = round(0.5 / env.control_dt + 0.49)
    for step in range(steps):
        assert not kneeling.kneeled.any()
        first = [step == 0, False, False]
        kneeling.update(kneel(env), moment(ALL, step * env.control_dt, first=first))
    assert kneeling.kneeled.tolist() == [True, False, False]
    took = kneeling.table(FALLEN)["kneel_time_s"]
    assert took[0] == pytest.approx((steps - 1) * env.control_dt, abs=1e-6)
    assert took[1:].isnan().all()
    trigger = kneeling.table(FALLEN)["trigger_s"]
    assert trigger[0] == 0.0  # there is no mode: the first touch
    assert trigger[1:].isnan().all()


def test_triggers_are_counted_from_the_push_and_not_before_it(make_base):
    """World 0 gave up before the push, world 1 does 0.08 s after it, world 2 never."""
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)

    def modes(*mode: int) -> TensorDict:
        td = kneel(env)
        return td.set("mode", torch.nn.functional.one_hot(torch.tensor(mode), 3).float())

    kneeling.before(modes(0, 0, 0), moment(ALL, -0.04))
    kneeling.before(modes(1, 0, 0), moment(ALL, 0.0))
    for step in range(1, 16):
        td = modes(1, int(step >= 2), 0)
        kneeling.update(td, moment(ALL, step * 0.04))
    table = kneeling.table(FALLEN)
    assert table["gave_up_before"].tolist() == [True, False, False]
    assert table["trigger_s"].nan_to_num(-1.0).tolist() == pytest.approx([-1.0, 0.08, -1.0])
    assert kneeling.kneeled.tolist() == [True, False, False]
    assert table["kneel_time_s"].isnan().all()  # of world 0 it is not known


def test_without_modes_a_touch_before_the_push_is_giving_up(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    kneeling.before(kneel(env), moment(ALL, 0.0, touched=[True, False, False]))
    kneeling.update(kneel(env), moment(ALL, 0.04, first=[False, True, False]))
    table = kneeling.table(FALLEN)
    assert table["gave_up_before"].tolist() == [True, False, False]
    assert table["trigger_s"].nan_to_num(-1.0).tolist() == pytest.approx([-1.0, 0.04, -1.0])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("base_linear_velocity", torch.tensor([0.0, 0.0, 0.11])),
        ("base_angular_velocity", torch.tensor([0.11, 0.0, 0.0])),
        ("joint_velocity", torch.nn.functional.one_hot(torch.tensor(7), 20) * -0.11),
        ("base_orientation", torch.tensor([np.cos(0.31), 0.0, np.sin(0.31), 0.0])),
    ],
)
def test_what_moves_or_leans_does_not_rest(make_base, key, value):
    env = make_base(num_envs=3)
    for scale, rests in ((1.0, False), (0.5, True)):
        if key == "base_orientation":
            value = torch.tensor([np.cos(0.31 * scale), 0.0, np.sin(0.31 * scale), 0.0])
            moved = value.float().repeat(3, 1)
        else:
            moved = (scale * value).float().repeat(3, 1)
        kneeling = Kneeling(env)
        td = kneel(env, **{key: moved})
        for step in range(30):
            kneeling.update(td, moment(ALL, step * 0.04))
        assert bool(kneeling.kneeled[0]) is rests


@pytest.mark.parametrize("region", ["torso", "head"])
def test_a_torso_or_head_on_the_floor_is_no_kneel_and_a_hand_is(make_base, region):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    td = kneel(env)
    for world, other in enumerate((region, "left_hand", "left_shin")):
        td["contact_force_peak"][world, env.regions.index("left_knee")] = 5.0
        td["contact_force_peak"][world, env.regions.index(other)] = 5.0
    for step in range(30):
        kneeling.update(td, moment(ALL, step * 0.04))
    assert kneeling.kneeled.tolist() == [False, True, True]


def test_impact_energy_is_that_of_the_step_before_the_touch(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    fast, slow = torch.tensor([[0.0, 0.0, -2.0]] * 3), torch.zeros(3, 3)
    kneeling.update(kneel(env, com_velocity=fast), moment(ALL, 0.1))
    kneeling.update(kneel(env, com_velocity=slow), moment(ALL, 0.2, first=[True, False, False]))
    energy = kneeling.table(FALLEN)["impact_energy"]
    assert energy[0].item() == pytest.approx(0.5 * env.mass * 4.0)
    assert energy[1:].isnan().all()


def test_impact_energy_is_of_the_mass_that_each_world_has_then(make_base):
    """Masses are drawn after the measuring has been set up: 0.8, 1 and 1.2 of the nominal one."""
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    links = env.physics_param_spec["link_mass"].shape[1]
    factor = torch.tensor([[0.8], [1.0], [1.2]])
    env.set_physics_params(TensorDict({"link_mass": factor.repeat(1, links)}, batch_size=[3]))
    fast = torch.tensor([[0.0, 0.0, -2.0]] * 3)
    kneeling.update(kneel(env, com_velocity=fast), moment(ALL, 0.1, first=ALL))
    energy = kneeling.table(FALLEN)["impact_energy"]
    assert energy.tolist() == pytest.approx((0.5 * env.mass * 4.0 * factor[:, 0]).tolist())


def test_contact_impulses_add_up_while_the_trial_goes_on(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    given = torch.full((3, len(env.regions)), 0.25)
    for _ in range(4):
        kneeling.update(kneel(env, contact_impulse=given), moment([True, False, True], 0.1))
    impulse = kneeling.table(FALLEN)["contact_impulse/torso"]
    assert impulse.tolist() == [1.0, 0.0, 1.0]


def test_a_kneel_counts_after_a_fall_in_sound_physics(make_base):
    """World 0 rests on its knee; that is an outcome only of a trial that fell."""
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    for step in range(30):
        kneeling.update(kneel(env), moment(ALL, step * 0.04))
    assert kneeling.table(FALLEN)["kneeled"].tolist() == [True, False, False]
    assert not kneeling.table(ended([False, True, True]))["kneeled"].any()
    broken = replace(FALLEN, diverged=torch.ones(3, dtype=torch.bool))
    assert not kneeling.table(broken)["kneeled"].any()


def test_a_trial_that_was_over_before_the_push_has_no_contact_impulses(make_base):
    env = make_base(num_envs=3)
    kneeling = Kneeling(env)
    kneeling.update(kneel(env), moment(ALL))
    table = kneeling.table(ended(ALL, before_push=[False, True, False]))
    assert table["contact_impulse/torso"].isnan().tolist() == [False, True, False]
