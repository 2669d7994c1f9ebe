"""Foot terms by hand."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.terms.feet import (
    balanced_load,
    carried_weight,
    centered_pressure,
    feet_in_contact,
    flat_feet,
    tangential_force,
)
from zfall.robots import ZEROTH01

NONE = TensorDict(batch_size=[3])
CONTACT = torch.tensor([[True, True], [True, False], [False, False]])


def test_contact_of_any_foot_or_of_both():
    td = TensorDict({"feet_contact": CONTACT}, batch_size=[3])
    assert feet_in_contact(NONE, td).tolist() == [[1.0], [1.0], [0.0]]
    assert feet_in_contact(NONE, td, both=True).tolist() == [[1.0], [0.0], [0.0]]


def test_load_is_1_on_half_the_weight_and_epsilon_a_cutoff_away():
    """m g / 2 = 16.43 N: all on one foot puts both feet 16.43 N off."""
    half = 0.5 * 3.3494 * 9.81
    force = torch.zeros(3, 2, 3)
    force[0, :, 2] = half
    force[1, 0, 2] = 2 * half
    force[2, 0, 2] = half  # one foot right, the other empty
    td = TensorDict({"feet_force": force}, batch_size=[3])
    value = balanced_load(NONE, td, robot=ZEROTH01, cutoff=half, epsilon=0.01)
    assert_close(value[:, 0], torch.tensor([1.0, 0.01, 0.505]), atol=1e-4, rtol=0)


def test_pressure_counts_feet_that_carry_something_alone():
    cop = torch.zeros(3, 2, 2)
    cop[0, 0] = torch.tensor([0.03, 0.04])  # 0.05 m off
    td = TensorDict({"feet_cop": cop, "feet_force": 20.0 * CONTACT[..., None].expand(3, 2, 3)}, [3])
    value = centered_pressure(NONE, td, cutoff=0.05, epsilon=0.1)
    assert_close(value[:, 0], torch.tensor([0.55, 0.5, 0.0]))


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.3])
def test_feet_are_flat_whatever_their_heading(angle):
    """1 - cos(angle) off the vertical; a turn about z changes nothing."""
    tipped = [math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0]
    turned = [math.cos(0.4), 0.0, 0.0, math.sin(0.4)]
    td = TensorDict({"feet_orientation": torch.tensor([[tipped, turned]])}, batch_size=[1])
    expected = 0.5 + 0.5 * 0.01 ** ((1 - math.cos(angle)) ** 2 / 0.05**2)
    value = flat_feet(NONE, td, cutoff=0.05, epsilon=0.01).item()
    assert value == pytest.approx(expected, abs=1e-4)


def test_weight_is_carried_by_both_feet_or_by_one():
    """m g = 32.86 N: in the air all of it is missing."""
    weight = 3.3494 * 9.81
    force = torch.zeros(3, 2, 3)
    force[0, :, 2] = torch.tensor([0.7, 0.3]) * weight
    force[1, 1, 2] = weight
    td = TensorDict({"feet_force": force}, batch_size=[3])
    value = carried_weight(NONE, td, robot=ZEROTH01, cutoff=weight, epsilon=0.01)
    assert_close(value[:, 0], torch.tensor([1.0, 1.0, 0.01]), atol=1e-4, rtol=0)


def test_sideways_forces_count_in_full_though_they_cancel():
    """3 N inward at each foot and 4 N forward at one: sqrt(9 + 9 + 16)."""
    force = torch.tensor([[[0.0, -3.0, 16.0], [4.0, 3.0, 17.0]]])
    td = TensorDict({"feet_force": force}, batch_size=[1])
    value = tangential_force(NONE, td, cutoff=34**0.5, epsilon=0.2)
    assert value.item() == pytest.approx(0.2)


def test_weight_of_each_foot_is_twice_that_of_their_mean():
    td = TensorDict(
        {
            "feet_force": torch.tensor([[[0.0, 0, 20.0], [0, 0, 5.0]]]),
            "feet_cop": torch.tensor([[[0.01, 0.0], [0.0, 0.03]]]),
            "feet_orientation": torch.tensor([[[0.995, 0.0999, 0.0, 0.0], [1.0, 0, 0, 0]]]),
        },
        batch_size=[1],
    )
    for term, values in (
        (balanced_load, {"robot": ZEROTH01, "cutoff": 16.4}),
        (centered_pressure, {"cutoff": 0.05}),
        (flat_feet, {"cutoff": 0.05}),
    ):
        mean, total = (term(td, td, epsilon=0.01, per_foot=p, **values) for p in (False, True))
        assert 0 < mean.item() < 1
        assert_close(total, 2 * mean)
