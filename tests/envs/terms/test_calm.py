"""Terms that count at rest alone, by hand."""

import math
from functools import partial

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.terms.calm import (
    at_rest,
    busiest_servo,
    idle_servos,
    rest_posture,
    still_actions,
    still_joints,
)
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.rewards import WeightedReward
from zfall.envs.transforms.windows import LastAction
from zfall.robots import ZEROTH01

BEFORE = TensorDict({k: torch.zeros(1, 20) for k in ("action", "last_action")}, [1])


def standing(*, away: float = 0.0, contact: tuple[bool, bool] = (True, True)) -> TensorDict:
    """A robot without motion, its center of mass ``away`` [m] from the middle of its feet."""
    values = {
        "com_position": torch.tensor([[away, 0.0, 0.22]]),
        "com_velocity": torch.zeros(1, 3),
        "feet_position": torch.tensor([[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]]),
        "feet_contact": torch.tensor([contact]),
        "joint_velocity": torch.zeros(1, 20),
        "joint_torque": torch.zeros(1, 20),
    }
    return TensorDict(values, batch_size=[1])


def test_rest_ends_as_the_capture_point_leaves():
    assert at_rest(BEFORE, standing(), reach=0.04).item() == 1.0
    assert at_rest(BEFORE, standing(away=0.04), reach=0.04).item() == pytest.approx(math.exp(-1))
    moving = standing()
    moving["com_velocity"] = torch.tensor([[0.0, 0.04 / math.sqrt(0.22 / 9.81), 0.0]])
    assert at_rest(BEFORE, moving, reach=0.04).item() == pytest.approx(math.exp(-1))


@pytest.mark.parametrize("contact", [(True, False), (False, True), (False, False)])
def test_who_lifts_a_foot_is_not_at_rest(contact):
    assert at_rest(BEFORE, standing(contact=contact), reach=0.04).item() == 0.0


@pytest.mark.parametrize(
    ("term", "key"),
    [(still_joints, "joint_velocity"), (still_actions, "action"), (idle_servos, "joint_torque")],
)
def test_each_falls_with_the_mean_square_over_joints(term, key):
    """Of 20 joints five at 0.4 have a mean square of 0.04: 1/e at a sigma of 0.2."""
    before, after = BEFORE.clone(), standing()
    assert term(before, after, reach=0.04, sigma=0.2).item() == 1.0
    (before if key == "action" else after)[key][:, :5] = 0.4
    assert term(before, after, reach=0.04, sigma=0.2).item() == pytest.approx(math.exp(-1))
    after["com_position"][:, 0] = 0.04
    assert term(before, after, reach=0.04, sigma=0.2).item() == pytest.approx(math.exp(-2))


def test_one_servo_under_load_counts_whatever_the_others_do():
    """1/e at a sigma of 0.4: 19 idle servos do not make up for it."""
    busiest = partial(busiest_servo, reach=0.04, sigma=0.4)
    after = standing()
    assert busiest(BEFORE, after).item() == 1.0
    after["joint_torque"][:, 3] = -0.4
    assert busiest(BEFORE, after).item() == pytest.approx(math.exp(-1))
    after["joint_torque"][:, 4:9] = 0.39
    assert busiest(BEFORE, after).item() == pytest.approx(math.exp(-1))
    after["com_position"][:, 0] = 0.04
    assert busiest(BEFORE, after).item() == pytest.approx(math.exp(-2))


def test_load_can_be_another_quantity():
    """1/e at a sigma of 0.2, whatever the torques of the moment are."""
    after = standing()
    after["joint_torque"][:] = 3.0
    after["mean_joint_torque"] = torch.full((1, 20), 0.2)
    value = idle_servos(BEFORE, after, reach=0.04, sigma=0.2, torque="mean_joint_torque")
    assert value.item() == pytest.approx(math.exp(-1))


def test_the_pose_to_rest_in_is_the_standing_pose_and_its_offsets():
    """Of 20 joints five away by 0.4 have a mean square of 0.04: 1/e at a sigma of 0.2."""
    after = standing()
    after["joint_position"] = torch.tensor([ZEROTH01.stand_position], dtype=torch.float32)
    rest = partial(rest_posture, robot=ZEROTH01, reach=0.04, sigma=0.2)
    assert rest(BEFORE, after).item() == pytest.approx(1.0)
    offsets = dict.fromkeys(ZEROTH01.joints[3:8], 0.4)
    assert rest(BEFORE, after, offsets=offsets).item() == pytest.approx(math.exp(-1))
    after["joint_position"][:, 3:8] += 0.4
    assert rest(BEFORE, after, offsets=offsets).item() == pytest.approx(1.0)
    after["com_position"][:, 0] = 0.04
    assert rest(BEFORE, after, offsets=offsets).item() == pytest.approx(math.exp(-1))
    with pytest.raises(ValueError, match="offsets must name joints of zeroth01, got knee"):
        rest(BEFORE, after, offsets={"knee": 0.1})
    with pytest.raises(ValueError, match="joints must name joints of zeroth01, got knee"):
        rest(BEFORE, after, joints=["knee"])
    with pytest.raises(ValueError, match="offsets must be of joints that count, left_knee_pitch"):
        rest(BEFORE, after, joints=["left_hip_pitch"], offsets={"left_knee_pitch": 0.1})


def test_a_pose_to_rest_in_may_be_one_of_some_joints():
    after = standing()
    after["joint_position"] = torch.tensor([ZEROTH01.stand_position], dtype=torch.float32)
    after["joint_position"][:, 3] += 0.3
    after["joint_position"][:, 5:] += 9.0  # which does not count
    rest = partial(rest_posture, robot=ZEROTH01, reach=0.04, sigma=0.2, joints=ZEROTH01.joints[3:5])
    assert rest(BEFORE, after).item() == pytest.approx(math.exp(-(0.3**2) / 2 / 0.2**2))


def test_actions_count_by_their_change_in_an_env_as_well(make_task):
    """Not by what the step has written already: the second step asks for 0.2 more than the first."""
    still = partial(still_actions, reach=10.0, sigma=0.2)
    env = make_task({
        "action": (JointPositionTarget, {"scale": 0.1}),
        "last": (lambda base: LastAction(), {}),
        "reward": (WeightedReward, {"terms": {"still": [1.0, still]}}),
    })  # fmt: skip
    td, seen = env.reset(), []
    for action in (0.1, 0.3, 0.3):
        td = env.step(td.set("action", torch.full((4, 20), action)))["next"]
        seen.append(td["reward"][0].item())
    calm = seen[2]
    assert calm == pytest.approx(1.0, abs=1e-2)
    assert seen[1] == pytest.approx(calm * math.exp(-1), rel=1e-2)
