"""Walks by the clock: the shipped motions are motions of the physics."""

import numpy as np
import pytest

from zfall.envs.open_loop import follow, pose_hold
from zfall.motions.library import gaits_of
from zfall.robots import ZEROTH01

GAITS = gaits_of(ZEROTH01)


@pytest.mark.parametrize("name", ["forward_0.20", "backward_0.10", "turn_left_1.0"])
def test_torques_by_inverse_dynamics_walk_the_robot_at_the_speed_of_the_name(name):
    """Nothing keeps the balance: a motion that is not one of the physics ends on the floor."""
    gait = GAITS[name]
    walked = follow(gait, "torque", seconds=2.4, starts=3)
    assert walked.seconds.min().item() == pytest.approx(2.4)
    np.testing.assert_allclose(walked.speed, gait.speed, atol=0.012)
    np.testing.assert_allclose(walked.turn_rate, gait.turn_rate, atol=0.05)


@pytest.mark.parametrize("name", ["forward_0.20", "backward_0.10", "turn_right_1.0"])
def test_angles_alone_and_the_standing_pose_keep_the_robot_up_for_a_second(name):
    for kind in ("position", "velocity"):
        walked = follow(GAITS[name], kind, seconds=1.0, starts=3)
        assert walked.seconds.min().item() == pytest.approx(1.0)
    assert pose_hold(GAITS[name], seconds=1.0, starts=3).seconds.min().item() == pytest.approx(1.0)
