"""When a robot stands again, and what falls cost, along histories that are written down."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.evaluation.followers import Ended, Moment
from zfall.falling.modes import KNEEL, MODES, RISE, one_hot
from zfall.falling.rising import Cycling, Rising
from zfall.robots import ZEROTH01

REGIONS = list(ZEROTH01.regions)
NO = torch.zeros(1, dtype=torch.bool)
ENDED = Ended(fell=~NO, diverged=NO, before_push=NO)


def newton_of(touches) -> float:
    return max(newton for region, newton in touches.items() if region != "right_foot")


def follow(follower, history) -> dict[str, float]:
    """``history``: rows of a number of steps, regions that touch with a force, and a push."""
    for steps, touches, push in history:
        force = torch.zeros(1, len(REGIONS))
        for region, newton in touches.items():
            force[0, REGIONS.index(region)] = newton
        stands = not any(touches.get(region, 0.0) for region in REGIONS[:-2])
        td = TensorDict(
            {
                "contact_force_peak": force,
                "base_orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
                "com_position": torch.tensor([[0.0, 0.0, 0.22 if stands else 0.05]]),
                "joint_torque_peak": torch.tensor([[0.1 * newton_of(touches)]]),
                ("push", "force"): torch.tensor([[push, 0.0, 0.0]]),
            },
            batch_size=[1],
        )
        for _ in range(steps):
            touched = torch.tensor([not stands])
            follower.update(td, Moment(1.0, ~NO, touched, NO, NO))
    return {name: value.item() for name, value in follower.table(ENDED).items()}


@pytest.fixture
def history():
    """Makes rows: ``stand`` and ``lie`` for a time [s]."""
    feet = {"left_foot": 16.0, "right_foot": 16.0}

    def stand(seconds, push=0.0):
        return (round(seconds / 0.04), feet, push)

    def lie(seconds, region="torso", newton=30.0, push=0.0):
        return (round(seconds / 0.04), {region: newton, "right_foot": 5.0}, push)

    return stand, lie


def test_it_stood_from_when_it_stands_for_half_a_second(make_base, history):
    """It lies for 2 s, stands for 0.4 s, lies for 0.6 s, and stands from 3 s on."""
    stand, lie = history
    rows = [lie(2.0), stand(0.4), lie(0.6), stand(1.0)]
    out = follow(Rising(make_base(num_envs=1)), rows)
    assert out["stood_s"] == pytest.approx(3.0, abs=0.05)
    assert out["stood"]
    out = follow(Rising(make_base(num_envs=1)), [*rows, lie(0.04)])
    assert out["stood_s"] == pytest.approx(3.0, abs=0.05)
    assert not out["stood"]  # at the end it lies again
    assert math.isnan(follow(Rising(make_base(num_envs=1)), [lie(1.0)])["stood_s"])


def test_falls_are_counted_until_they_end_standing(make_base, history):
    """One ends after 4 s, one after 9 s, and one is 3 s old at the end: 16 s on the floor."""
    stand, lie = history
    rows = [stand(1.0), lie(4.0), stand(2.0), lie(9.0), stand(2.0), lie(3.0)]
    out = follow(Cycling(make_base(num_envs=1)), rows)
    assert (out["falls"], out["falls_stood"], out["falls_open"]) == (3, 1, 1)
    # Half a second of standing ends each of the first two, 13 steps of 40 ms.
    assert out["down_s"] == pytest.approx(16.0 + 2 * 0.52, abs=0.05)
    late = follow(Cycling(make_base(num_envs=1)), [stand(1.0), lie(9.0)])
    assert (late["falls"], late["falls_stood"], late["falls_open"]) == (1, 0, 0)


def test_a_fall_that_begins_too_late_is_not_judged_whatever_comes_of_it(make_base, history):
    """Of two that end after 1 s, one begins 9.0 s before the end and one 8.0 s."""
    stand, lie = history
    early = follow(Cycling(make_base(num_envs=1)), [stand(1.0), lie(1.0), stand(8.0)])
    assert (early["falls"], early["falls_stood"], early["falls_open"]) == (1, 1, 0)
    late = follow(Cycling(make_base(num_envs=1)), [stand(1.0), lie(1.0), stand(7.0)])
    assert (late["falls"], late["falls_stood"], late["falls_open"]) == (1, 0, 1)


def test_a_wobble_within_a_fall_is_no_other_fall(make_base, history):
    stand, lie = history
    out = follow(Cycling(make_base(num_envs=1)), [lie(1.0), stand(0.4), lie(1.0), stand(7.0)])
    assert (out["falls"], out["falls_stood"]) == (1, 1)


def test_pushes_are_met_by_who_is_not_down(make_base, history):
    stand, lie = history
    rows = [stand(0.2, push=40.0), stand(0.4), stand(0.2, push=-40.0), lie(1.0), lie(0.2, push=9.0)]
    out = follow(Cycling(make_base(num_envs=1)), [*rows, stand(1.0), stand(0.1, push=1.0)])
    assert (out["pushes_met"], out["pushes_down"]) == (3, 1)


def test_the_first_second_of_a_fall_is_its_landing(make_base, history):
    """Two falls: torso with 300 N, then the hand with 50 N, and the head after the first second."""
    stand, lie = history
    rows = [lie(0.2, "torso", 300.0), lie(1.5, "left_hand", 20.0), stand(1.0)]
    rows += [lie(1.0, "left_hand", 50.0), lie(1.0, "head", 80.0), stand(1.0)]
    out = follow(Cycling(make_base(num_envs=1)), rows)
    assert out["falls"] == 2
    assert out["landing_force"] == 300.0 + 50.0
    assert out["landing_vulnerable"] == 1.0
    assert out["rise_force"] == 20.0 + 80.0
    assert out["landing_torque"] == pytest.approx(30.0 + 5.0)


def test_it_is_said_which_worlds_begin_to_get_up():
    mode = one_hot(torch.tensor([RISE, KNEEL]), len(MODES))
    (said,) = Cycling.remarks(TensorDict({"mode": mode}, batch_size=[2])).items()
    assert said[0] == "gets up"
    assert said[1].tolist() == [True, False]
    assert Cycling.remarks(TensorDict({"mode": mode[:, :RISE]}, batch_size=[2])) == {}
