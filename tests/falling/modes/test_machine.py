"""The mode machine against a reference for one world, in plain Python."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from zfall.falling.modes import (
    KNEEL,
    RECOVER,
    RISE,
    STABLE,
    ModeMachine,
    ModeRule,
    in_danger,
    modes_over,
)


def reference(danger, resting, standing, hold, rest, back, rise) -> list[int]:
    """One world, as the report words it: so many frames in a row, never back unless asked for."""
    mode, modes, run, calm = RECOVER, [], 0, 0
    for bad, still, up in zip(danger, resting, standing, strict=True):
        if mode == RECOVER:
            run = run + 1 if bad else 0
            if run == hold:
                mode, run, calm = KNEEL, 0, 0
        else:
            rests = mode == KNEEL or (mode == STABLE and rise is not None)
            run = run + 1 if still and rests else 0
            calm = calm + 1 if up else 0
            if mode == KNEEL and run == rest:
                mode, run, calm = STABLE, 0, 0
            elif mode == STABLE and run == rise:
                mode, run, calm = RISE, 0, 0
            elif back is not None and calm >= back:
                mode, run, calm = RECOVER, 0, 0
        modes.append(mode)
    return modes


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 6),
    st.integers(1, 6),
    st.one_of(st.none(), st.integers(1, 6)),
    st.one_of(st.none(), st.integers(1, 6)),
    st.floats(0.5, 0.95),
)
def test_histories_of_many_worlds_equal_those_of_single_ones(seed, hold, rest, back, rise, often):
    generator = torch.Generator().manual_seed(seed)
    conditions = torch.rand(3, 60, 8, generator=generator) < often
    modes = modes_over(ModeRule(hold=hold, rest=rest, back=back, rise=rise), *conditions)
    for world in range(8):
        alone = reference(*conditions[:, :, world].tolist(), hold, rest, back, rise)
        assert modes[:, world].tolist() == alone


def step(lean: list[float], rate: list[float], knee: list[bool], env) -> TensorDict:
    """What a transform sees after a step: trunk pitched by ``lean``, a knee on the floor."""
    n = len(lean)
    half = torch.tensor(lean) / 2
    zero = torch.zeros(n)
    force = torch.zeros(n, len(env.regions))
    force[:, env.regions.index("left_knee")] = torch.tensor(knee).float()
    return TensorDict(
        {
            "base_orientation": torch.stack([half.cos(), zero, half.sin(), zero], -1),
            "base_angular_velocity": torch.tensor(rate)[:, None] * torch.tensor([0.0, 1.0, 0.0]),
            "base_linear_velocity": torch.zeros(n, 3),
            "joint_velocity": torch.zeros(n, 20),
            "contact_force_peak": force,
        },
        batch_size=[n],
    )


def play(machine: ModeMachine, env, steps) -> list[list[int]]:
    n = env.num_envs
    td = machine._reset(TensorDict(batch_size=[n]), TensorDict(batch_size=[n]))
    modes = []
    for lean, rate, knee in steps:
        after = step(lean, rate, knee, env)
        td = machine._step(td, after)
        modes.append(td["mode"].argmax(-1).tolist())
    return modes


def test_ten_frames_beyond_half_a_radian_or_two_radians_per_second(make_base):
    """World 0 leans by 0.51, world 1 by 0.49, world 2 turns with 2.1 rad/s, world 3 recovers once."""
    env = make_base(num_envs=4, control_dt=0.02)
    machine = ModeMachine(env)
    pushed = ([0.51, 0.49, 0.0, 0.6], [0.0, 1.9, 2.1, 0.0], [False] * 4)
    calm = ([0.51, 0.49, 0.0, 0.0], [0.0, 1.9, 2.1, 0.0], [False] * 4)
    modes = play(machine, env, [*[pushed] * 5, calm, *[pushed] * 13])
    first = [
        [m[w] for m in modes].index(KNEEL) if KNEEL in [m[w] for m in modes] else None
        for w in range(4)
    ]
    assert first == [9, None, 9, 15]  # the tenth frame; anew after the calm one


def test_a_kneel_that_rests_for_half_a_second_is_stable_and_stays(make_base):
    env = make_base(num_envs=2, control_dt=0.04)
    machine = ModeMachine(env, initial="kneel")
    down, up = ([0.2] * 2, [0.0] * 2, [True, False]), ([0.2] * 2, [0.0, 0.0], [False, False])
    modes = [m[0] for m in play(machine, env, [*[down] * 11, up, *[down] * 12, *[up] * 30])]
    assert modes[:23] == [KNEEL] * 23  # 0.48 s twice, with a break
    assert modes[23:] == [STABLE] * 31


def test_bounds_of_rest_can_be_wide_for_who_explores(make_base):
    """A knee down, the base creeping and one joint moving: rest within wide bounds alone."""
    env = make_base(num_envs=1)
    wide = {"rest_speed": 0.5, "rest_joint_speed": 3.1}
    for names, end in (
        ((), KNEEL),
        (["rest_joint_speed"], KNEEL),
        (["rest_speed"], KNEEL),
        (wide, STABLE),
    ):
        given = {name: wide[name] for name in names}
        machine = ModeMachine(env, initial="kneel", **given)
        td = machine._reset(TensorDict(batch_size=[1]), TensorDict(batch_size=[1]))
        for _ in range(13):
            after = step([0.2], [0.4], [True], env)
            after["joint_velocity"][:, 7] = -3.0
            td = machine._step(td, after)
        assert td["mode"].argmax(-1).tolist() == [end]


def test_the_way_back_must_be_asked_for(make_base):
    up = ([0.1], [0.0], [False])
    for back, end in ((None, KNEEL), (0.2, RECOVER)):
        env = make_base(num_envs=1)
        assert play(ModeMachine(env, initial="kneel", back=back), env, [up] * 5)[-1] == [end]


@pytest.mark.parametrize(("lean", "knee"), [(0.2, True), (1.5, True)])
def test_what_rests_on_a_knee_or_lies_gets_up_and_then_recovers(make_base, lean, knee):
    """At 25 Hz: 0.2 s at rest until STABLE are 5 steps, 0.12 s until RISE 3, 0.2 s standing 5."""
    env = make_base(num_envs=1)
    machine = ModeMachine(env, rest=0.2, rise=0.12, back=0.2, initial="kneel")
    down, up = ([lean], [0.0], [knee]), ([0.1], [0.0], [False])
    modes = [m[0] for m in play(machine, env, [*[down] * 10, *[up] * 4, down, *[up] * 6])]
    assert modes[:10] == [*[KNEEL] * 4, *[STABLE] * 3, *[RISE] * 3]
    assert modes[10:] == [*[RISE] * 9, *[RECOVER] * 2]  # only the second time it stands long enough


def test_only_a_machine_that_rises_has_a_fourth_mode(make_base):
    env = make_base(num_envs=2)
    for values, width in (({}, 3), ({"rise": 0.2, "back": 0.5}, 4)):
        machine = ModeMachine(env, **values)
        td = machine._reset(TensorDict(batch_size=[2]), TensorDict(batch_size=[2]))
        assert td["mode"].tolist() == [[1.0] + [0.0] * (width - 1)] * 2
        assert machine.mirror_signs["mode"] == (1.0,) * width
        spec = machine.transform_observation_spec(env.observation_spec.clone())
        assert spec["mode"].shape == (2, width)


def test_a_reset_touches_its_rows_alone(make_base):
    env = make_base(num_envs=3)
    machine = ModeMachine(env, hold=0.4)
    td = machine._reset(TensorDict(batch_size=[3]), TensorDict(batch_size=[3]))
    for _ in range(4):
        td = machine._step(td, step([0.7] * 3, [0.0] * 3, [False] * 3, env))
    assert machine.ahead.tolist() == [4, 4, 4]
    reset = TensorDict({"_reset": torch.tensor([[False], [True], [False]])}, batch_size=[3])
    machine._reset(reset, TensorDict(batch_size=[3]))
    assert machine.ahead.tolist() == [4, 0, 4]


def test_a_robot_alone_runs_the_same_code(make_base):
    """What deployment does with logged tilts and rates, against the transform."""
    generator = torch.Generator().manual_seed(1)
    lean = 0.9 * torch.rand(80, 1, generator=generator).cumsum(0).sin().abs()
    rate = 2.5 * torch.rand(80, 1, generator=generator)
    env = make_base(num_envs=1)
    machine = ModeMachine(env, hold=0.12)
    steps = [([float(a)], [float(w)], [False]) for a, w in zip(lean, rate, strict=True)]
    online = torch.tensor(play(machine, env, steps))
    danger = in_danger(lean, rate, angle=0.5, angular_velocity=2.0)
    no = torch.zeros_like(danger)
    assert torch.equal(online, modes_over(machine.rule, danger, no, no))
    assert KNEEL in online


def test_a_predicted_fall_takes_the_place_of_the_bounds(make_base):
    env = make_base(num_envs=2)
    machine = ModeMachine(env, probability=0.7, hold=0.08)
    td = machine._reset(TensorDict(batch_size=[2]), TensorDict(batch_size=[2]))
    for _ in range(2):
        after = step([1.2, 0.0], [0.0, 0.0], [False] * 2, env)
        after["fall_probability"] = torch.tensor([[0.6], [0.8]])
        td = machine._step(td, after)
    assert td["mode"].argmax(-1).tolist() == [RECOVER, KNEEL]


def test_nothing_foreseen_a_robot_that_leans_too_far_is_lost(make_base):
    env = make_base(num_envs=3)
    leans = [0.9, 1.1, 1.1]
    modes = []
    for lost in (1.0, None):
        machine = ModeMachine(env, probability=0.7, hold=0.04, lost=lost)
        td = machine._reset(TensorDict(batch_size=[3]), TensorDict(batch_size=[3]))
        after = step(leans, [0.0] * 3, [False] * 3, env)
        after["fall_probability"] = torch.zeros(3, 1)
        modes.append(machine._step(td, after)["mode"].argmax(-1).tolist())
    assert modes == [[0, 1, 1], [0, 0, 0]]
    machine = ModeMachine(env, angle=math.inf, angular_velocity=math.inf, hold=0.04, lost=1.0)
    assert machine._step(td, after)["mode"].argmax(-1).tolist() == [0, 1, 1]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"hold": 0.0}, "hold must be positive, got 0.0"),
        ({"angle": -0.1}, "angle must be positive"),
        ({"initial": "fall"}, "initial must be one of recover, kneel, stable, got 'fall'"),
        ({"probability": 1.5}, "probability must lie in"),
        ({"initial": "rise"}, "initial must be one of recover, kneel, stable, got 'rise'"),
        ({"rise": 0.2}, "back must be a time where there is rise"),
        ({"rise": -1.0, "back": 0.5}, "rise must be positive"),
    ],
)
def test_bad_values_are_refused(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        ModeMachine(make_base(), **values)


def test_a_hold_shorter_than_a_step_is_one_step(make_base):
    assert ModeMachine(make_base(control_dt=0.04), hold=0.001).rule.hold == 1
    assert math.isclose(ModeMachine(make_base(control_dt=0.02)).rule.hold * 0.02, 0.2)


@pytest.mark.parametrize("fall", [0.95, 0.2])
def test_a_predicted_fall_keeps_the_way_back_shut(make_base, fall):
    """Upright and untouched: 0.08 s of danger are two steps, 0.12 s of calm three."""
    env = make_base(num_envs=1)
    machine = ModeMachine(env, probability=0.7, hold=0.08, back=0.12)
    td = step([0.0], [0.0], [False], env)
    td["mode"] = machine._reset(TensorDict(batch_size=[1]), TensorDict(batch_size=[1]))["mode"]
    seen = []
    for k in range(10):
        td["fall_probability"] = torch.tensor([[0.95 if k < 2 else fall]])
        after = machine._step(td, td.clone())
        td["mode"] = after["mode"]
        seen.append(int(after["mode"].argmax()))
    back = RECOVER if fall < 0.7 else KNEEL
    assert seen == [RECOVER, KNEEL, KNEEL, KNEEL, *[back] * 6]


def test_a_probability_asks_for_a_predictor(make_task):
    table = {"mode": (ModeMachine, {"probability": 0.5})}
    with pytest.raises(ValueError, match="probability must be null without a FallPredictor"):
        make_task(table).observation_spec  # noqa: B018
