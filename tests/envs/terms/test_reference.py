"""Terms of the reference by hand, and the feet's by the printed formulas."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.terms.reference import (
    base_turning,
    configuration_error,
    feet_relative_orientation,
    feet_relative_position,
    odometry_velocity,
    reference_configuration,
)
from zfall.robots import ZEROTH01
from zfall.simulation.stance import stance

NONE = TensorDict(batch_size=[1])
VALUES = {"robot": ZEROTH01, "epsilon": 0.01}


def of(**values: list) -> TensorDict:
    return TensorDict({key: torch.tensor([value]).float() for key, value in values.items()}, [1])


def test_odometry_counts_a_turn_by_its_radius():
    """(0.3, 0) m/s and 2 rad/s at 0.2 m: 0.5 m/s in all."""
    td = of(odometry_velocity=[0.3, 0.0, 2.0])
    value = odometry_velocity(NONE, td, radius=0.2, cutoff=0.5, epsilon=0.05)
    assert value.item() == pytest.approx(0.05)
    assert odometry_velocity(
        NONE, td, radius=0.0, cutoff=0.3, epsilon=0.05
    ).item() == pytest.approx(0.05)


def test_configuration_is_that_of_the_legs_whatever_the_arms_do():
    """Twelve joints off by 0.1 rad are 0.1 sqrt(12) off together."""
    position = torch.tensor(ZEROTH01.stand_position).repeat(2, 1)
    position[:, :12] += 0.1
    position[1, 12:] -= 0.5
    td = TensorDict({"joint_position": position}, [2])
    off = 0.1 * math.sqrt(12)
    assert_close(configuration_error(position, ZEROTH01, "legs"), torch.full((2, 1), off))
    value = reference_configuration(NONE, td, cutoff=off, **VALUES)
    assert_close(value, torch.full((2, 1), 0.01))
    everything = reference_configuration(NONE, td, cutoff=off, joints="all", **VALUES)
    assert_close(everything[0], torch.tensor([0.01]))
    assert everything[1] < 1e-6


def standing(turn: Rotation, place: list[float], right: Rotation, shift: list[float]) -> TensorDict:
    """Feet of the standing pose, the right one moved in its own frame, then both as one body."""
    offset = stance(ZEROTH01).feet_offset.double().numpy()
    position = np.stack([np.zeros(3), offset + shift])
    orientation = [turn, turn * right]
    return of(
        feet_position=(turn.apply(position) + place).tolist(),
        feet_orientation=[r.as_quat()[[3, 0, 1, 2]].tolist() for r in orientation],
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_goes_elsewhere_as_it_is_keeps_its_feet_as_they_are(seed):
    turn = Rotation.random(random_state=seed)
    td = standing(turn, [3.0, -2.0, 0.4], Rotation.identity(), [0.0, 0.0, 0.0])
    assert feet_relative_position(NONE, td, cutoff=0.01, **VALUES).item() > 0.999
    assert feet_relative_orientation(NONE, td, cutoff=0.01, **VALUES).item() > 0.99
    td["feet_orientation"][0, 1] *= -1  # the same orientation
    assert feet_relative_position(NONE, td, cutoff=0.01, **VALUES).item() > 0.999
    assert feet_relative_orientation(NONE, td, cutoff=0.01, **VALUES).item() > 0.99


def test_a_foot_that_is_moved_counts_its_way():
    """(3, 0, 4) cm."""
    td = standing(
        Rotation.random(random_state=0), [1.0, 1.0, 0.0], Rotation.identity(), [0.03, 0.0, 0.04]
    )
    value = feet_relative_position(NONE, td, cutoff=0.05, **VALUES)
    assert value.item() == pytest.approx(0.01, rel=1e-3)


def test_a_foot_that_is_turned_counts_its_angle():
    right = Rotation.from_rotvec([0.1, -0.2, 0.2])  # by 0.3 rad
    td = standing(Rotation.random(random_state=1), [0.0, 0.0, 0.0], right, [0.0, 0.0, 0.0])
    value = feet_relative_orientation(NONE, td, cutoff=0.3, **VALUES)
    assert value.item() == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_both_follow_the_formulas_of_the_mean_foot(seed):
    """R_m from (q_r + q_l) / 2; R_m^T (p_r - p_l) and R_m^T (R_r R_l^T) R_m, feet far apart."""
    rng = np.random.default_rng(seed)
    left = Rotation.random(random_state=seed)
    right = left * Rotation.from_rotvec(rng.uniform(-0.8, 0.8, 3))
    place = 0.2 * rng.standard_normal((2, 3))
    quaternions = np.stack([r.as_quat() for r in (left, right)])
    td = of(feet_position=place.tolist(), feet_orientation=quaternions[:, [3, 0, 1, 2]].tolist())
    quaternions *= np.sign(quaternions[0] @ quaternions[1]) ** np.arange(2)[:, None]
    mean = Rotation.from_quat(quaternions.mean(0))
    offset = mean.inv().apply(place[1] - place[0]) - stance(ZEROTH01).feet_offset.numpy()
    value = feet_relative_position(NONE, td, cutoff=0.5, **VALUES).item()
    assert value == pytest.approx(0.01 ** (offset @ offset / 0.25), rel=1e-3)
    turn = mean.inv() * (right * left.inv()) * mean
    angle = turn.magnitude()  # the reference has the feet parallel
    value = feet_relative_orientation(NONE, td, cutoff=1.0, **VALUES).item()
    assert value == pytest.approx(0.01 ** (angle**2), rel=2e-3)


def test_turning_counts_all_axes():
    td = of(base_mean_angular_velocity=[2.0, -1.0, 2.0])
    assert base_turning(NONE, td, cutoff=3.0, epsilon=0.1).item() == pytest.approx(0.1)
