"""Terms that count at rest alone, by hand."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.terms.calm import at_rest, idle_servos, still_joints, still_targets

BEFORE = TensorDict({"target": torch.zeros(1, 20)}, batch_size=[1])


def standing(*, away: float = 0.0, contact: tuple[bool, bool] = (True, True)) -> TensorDict:
    """A robot without motion, its center of mass ``away`` [m] from the middle of its feet."""
    values = {
        "com_position": torch.tensor([[away, 0.0, 0.22]]),
        "com_velocity": torch.zeros(1, 3),
        "feet_position": torch.tensor([[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]]),
        "feet_contact": torch.tensor([contact]),
        "joint_velocity": torch.zeros(1, 20),
        "joint_torque": torch.zeros(1, 20),
        "target": torch.zeros(1, 20),
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
    [(still_joints, "joint_velocity"), (still_targets, "target"), (idle_servos, "joint_torque")],
)
def test_each_falls_with_the_mean_square_over_joints(term, key):
    """Of 20 joints five at 0.4 have a mean square of 0.04: 1/e at a sigma of 0.2."""
    td = standing()
    assert term(BEFORE, td, reach=0.04, sigma=0.2).item() == 1.0
    td[key][:, :5] = 0.4
    assert term(BEFORE, td, reach=0.04, sigma=0.2).item() == pytest.approx(math.exp(-1))
    td["com_position"][:, 0] = 0.04
    assert term(BEFORE, td, reach=0.04, sigma=0.2).item() == pytest.approx(math.exp(-2))


def test_targets_count_by_their_change():
    before, after = BEFORE.clone(), standing()
    before["target"] += 0.7
    after["target"] += 0.9
    assert still_targets(before, after, reach=1.0, sigma=0.2).item() == pytest.approx(math.exp(-1))
