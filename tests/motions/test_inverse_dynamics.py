"""Torques of a walk."""

import numpy as np
import pytest

from zfall.motions.inverse_dynamics import servo_torque, weight_shares
from zfall.motions.library import gaits_of, walk
from zfall.robots import ZEROTH01

GAITS = gaits_of(ZEROTH01)


def test_weight_goes_evenly_from_foot_to_foot_in_double_support():
    """Of 30 ms about the touchdowns, every 0.3 s; the left foot is the first to stand."""
    time = np.array([0.015, 0.15, 0.285, 0.2925, 0.3, 0.315, 0.45, 0.6, 0.6075])
    left = [1, 1, 1, 0.75, 0.5, 0, 0, 0.5, 0.75]
    shares = weight_shares(GAITS["forward_0.10"], time)
    np.testing.assert_allclose(shares[:, 0], left, atol=1e-9)
    np.testing.assert_allclose(shares.sum(-1), 1)


@pytest.mark.parametrize("name", ["forward_0.15", "turn_left_0.5"])
def test_work_of_the_servos_over_a_stride_is_what_the_gears_lose(name):
    """A stride ends with the energy it began with; soles at rest do no work."""
    gait = GAITS[name]
    begin, end = gait.stride
    time = np.linspace(begin, end, 601)
    speed = walk(ZEROTH01, gait, time)["joint_velocity"]
    work = np.trapezoid((servo_torque(ZEROTH01, gait, time) * speed).sum(-1), time)
    damping, friction = 1.3464, 0.2  # of the leg servos [N m s/rad, N m]; the arms are at rest
    loss = np.trapezoid((damping * speed**2 + friction * np.abs(speed)).sum(-1), time)
    assert work == pytest.approx(loss, rel=0.02)
