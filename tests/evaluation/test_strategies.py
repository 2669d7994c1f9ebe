"""Strategies of made-up and of simulated trials."""

from types import SimpleNamespace

import pandas as pd
import pytest
import torch
from tensordict import TensorDict

from tests.evaluation.moments import ended, moment
from zfall.evaluation.strategies import AMOUNTS, Footsteps, Strategies, strategy_table
from zfall.robots import ZEROTH01


def record(num: int = 1, **values: torch.Tensor) -> TensorDict:
    upright = torch.tensor([1.0, 0, 0, 0]).expand(num, 2, 4)
    rest = {
        "com_position": torch.zeros(num, 3),
        "com_velocity": torch.zeros(num, 3),
        "joint_position": torch.zeros(num, 20),
        "feet_contact": torch.ones(num, 2, dtype=torch.bool),
        "feet_position": torch.zeros(num, 2, 3),
        "feet_orientation": upright,
        "angular_momentum": torch.zeros(num, 3),
    }
    return TensorDict(rest | values, [num])


def follow(make_base, steps: list[TensorDict]) -> dict[str, torch.Tensor]:
    strategies = Strategies(make_base(num_envs=1))
    strategies.before(record(), moment([True], -0.04))
    for number, td in enumerate(steps, 1):
        strategies.update(td, moment([True], 0.04 * number))
    return strategies.table(ended([False]))


def used(table: dict[str, torch.Tensor]) -> set[str]:
    return {name.split("/")[1] for name, value in table.items() if "/" in name and value.item()}


def test_standing_still_is_ankle_alone(make_base):
    table = follow(make_base, [record() for _ in range(5)])
    assert used(table) == {"ankle"}
    assert table["recovery_time_s"].item() == 0.0
    assert table["steps"].item() == 0


@pytest.mark.parametrize(("stride", "steps"), [(0.09, 1), (0.07, 0)])
def test_a_step_of_a_robot_four_times_as_high_is_four_times_as_long(stride, steps):
    robot = SimpleNamespace(com_height=4 * ZEROTH01.com_height, mass=1.0)
    feet = Footsteps(SimpleNamespace(num_envs=1, robot=robot))
    lifted, moved = torch.tensor([[False, True]]), torch.zeros(1, 2, 3)
    moved[0, 0, 0] = stride
    feet.update(record(feet_contact=lifted))
    feet.update(record(feet_contact=lifted, feet_position=moved))
    assert feet.update(record(feet_position=moved)).sum() == steps


@pytest.mark.parametrize(("stride", "steps"), [(0.03, 1), (0.01, 0)])
def test_a_step_is_a_foot_that_comes_down_elsewhere(make_base, stride, steps):
    """The left foot leaves, is carried forward in the air, and comes down."""
    lifted = torch.tensor([[False, True]])
    moved = torch.zeros(1, 2, 3)
    moved[0, 0, 0] = stride
    table = follow(
        make_base,
        [
            record(feet_contact=lifted),
            record(feet_contact=lifted, feet_position=moved),
            record(feet_position=moved),
            record(feet_position=moved),
        ],
    )
    assert table["steps"].item() == steps
    assert used(table) == ({"stepping"} if steps else {"ankle"})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("jumping", {"feet_contact": torch.zeros(1, 2, dtype=torch.bool)}),
        ("foot_tilting", {"feet_orientation": torch.tensor([[[1.0, 0, 0, 0], [0.9950, 0.0998, 0, 0]]])}),
        ("angular_momentum", {"angular_momentum": torch.tensor([[0.0, 0.06, 0.0]])}),
    ],
)  # fmt: skip
def test_each_has_its_sign(make_base, name, values):
    assert used(follow(make_base, [record(), record(**values), record()])) == {name}


def test_hip_counts_from_where_it_was(make_base):
    env = make_base(num_envs=1)
    joints = torch.zeros(1, 20)
    joints[0, env.robot.joints.index("left_hip_roll")] = 0.3
    assert used(follow(make_base, [record(joint_position=joints)])) == {"hip"}
    knees = torch.zeros(1, 20)
    knees[0, env.robot.joints.index("left_knee_pitch")] = 0.9
    assert used(follow(make_base, [record(joint_position=knees)])) == {"ankle"}


def test_recovery_lasts_until_the_last_motion(make_base):
    moving = torch.tensor([[0.2, 0.0, 0.0]])
    away = torch.tensor([[0.03, -0.04, 0.0]])
    steps = [record(com_velocity=moving), record(), record(com_velocity=moving)]
    table = follow(make_base, [*steps, record(com_position=away)])
    assert table["recovery_time_s"].item() == pytest.approx(0.12)
    assert table["displacement"].item() == pytest.approx(0.05)
    still_moving = follow(make_base, [record(), record(com_velocity=moving)])
    assert still_moving["recovery_time_s"].isnan()


def test_a_step_under_way_at_the_push_counts_from_where_it_began(make_base):
    """Lifted and carried 15 mm before the push, 15 mm more after it: one step of 30 mm."""
    lifted = torch.tensor([[False, True]])
    half, whole = torch.zeros(1, 2, 3), torch.zeros(1, 2, 3)
    half[0, 0, 0], whole[0, 0, 0] = 0.015, 0.03
    strategies = Strategies(make_base(num_envs=1))
    strategies.before(record(), moment([True], -0.08))
    strategies.before(record(feet_contact=lifted, feet_position=half), moment([True], -0.04))
    strategies.update(record(feet_position=whole), moment([True], 0.04))
    assert strategies.table(ended([False]))["steps"].item() == 1


def trials(amounts: dict[str, list[float]], *, impulse: float) -> pd.DataFrame:
    """Recovered trials, pushed forward, with the given amounts; the rest is as of a robot at rest."""
    n = len(next(iter(amounts.values())))
    rest = {column: [0.0] * n for column, _ in AMOUNTS.values()}
    table = pd.DataFrame(
        {**rest, **amounts, "impulse": impulse, "recovered": True, "direction_rad": 0.0}
    )
    for name, (column, bound) in AMOUNTS.items():
        table[f"strategy/{name}"] = table[column] > bound
    return table.assign(
        **{"strategy/ankle": ~table[[f"strategy/{name}" for name in AMOUNTS]].any(axis=1)}
    )


def test_of_one_that_always_steps_only_the_steps_beyond_its_usual_ones_are_the_pushs():
    """With no push it takes 10 to 12 steps, pushed 11, 12, 13 and 20: two of four took more than ever."""
    control = trials({"steps": [10, 11, 12, 12], "hip_rad": [0.1, 0.1, 0.1, 0.2]}, impulse=0.0)
    pushed = trials({"steps": [11, 12, 13, 20], "hip_rad": [0.22, 0.2, 0.3, 0.1]}, impulse=0.4)
    table = strategy_table(pd.concat([control, pushed]))
    assert list(table["side"]) == ["no push", "forward"]
    assert list(table["stepping"]) == [1.0, 0.5]
    assert list(table["hip"]) == [0.0, 0.25]  # 0.22 is more than usual, but not above the bound
    assert list(table["ankle"]) == [0.0, 0.0]
    assert table["as_usual"].iloc[1] == 0.5
    assert list(table["recovered"]) == [4, 4]


def test_of_one_that_stands_still_every_step_is_the_pushs():
    control = trials({"steps": [0.0] * 20}, impulse=0.0)
    pushed = trials({"steps": [0, 1, 2, 0]}, impulse=0.4)
    table = strategy_table(pd.concat([control, pushed]))
    assert list(table["stepping"]) == [0.0, 0.5]
    assert list(table["ankle"]) == [1.0, 0.5]


def test_fallen_control_trials_tell_nothing():
    control = trials({"steps": [50, 0]}, impulse=0.0).assign(recovered=[False, True])
    table = strategy_table(pd.concat([control, trials({"steps": [2]}, impulse=0.4)]))
    assert list(table["stepping"]) == [0.0, 1.0]


def test_one_in_twenty_of_the_control_trials_may_be_unusual():
    """19 of 20 took at most 3 steps, so that 4 are more than usual and 3 are not."""
    control = trials({"steps": [3.0] * 19 + [9.0]}, impulse=0.0)
    table = strategy_table(pd.concat([control, trials({"steps": [3, 4, 9, 10]}, impulse=0.4)]))
    assert table["stepping"].iloc[1] == 0.75


def test_without_a_control_trial_that_recovered_nothing_is_claimed():
    control = trials({"steps": [5]}, impulse=0.0).assign(recovered=False)
    table = strategy_table(pd.concat([control, trials({"steps": [9]}, impulse=0.4)]))
    assert list(table["side"]) == ["forward"]
    assert table[["stepping", "as_usual"]].isna().all(axis=None)


def test_trials_of_before_the_amounts_claim_nothing():
    old = trials({"steps": [5, 6]}, impulse=0.0).drop(columns="hip_rad")
    new = trials({"steps": [9]}, impulse=0.4)
    assert "stepping" not in strategy_table(pd.concat([old, new]))


def test_amounts_are_the_largest_and_times_until_the_fall(make_base):
    air = {"feet_contact": torch.zeros(1, 2, dtype=torch.bool)}
    leaning = {
        "feet_orientation": torch.tensor([[[1.0, 0, 0, 0], [0.9950, 0.0998, 0, 0]]])
    }  # 0.2 rad
    table = follow(make_base, [record(**air), record(**leaning), record(**air), record()])
    assert table["flight_s"].item() == pytest.approx(0.08)
    assert table["foot_tilt_rad"].item() == pytest.approx(0.2, abs=1e-3)
    assert table["hip_rad"].item() == 0.0
