"""Fall conditions, each triggered and just not."""

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from zfall.envs.terms.falls import base_height, body_contact, low, tilted
from zfall.robots import ZEROTH01

NONE = TensorDict(batch_size=[1])


@pytest.mark.parametrize("region", ZEROTH01.regions)
def test_every_region_but_the_feet_counts_as_a_fall(region):
    force = torch.zeros(1, len(ZEROTH01.regions))
    force[0, ZEROTH01.regions.index(region)] = 0.1
    td = TensorDict({"contact_force_peak": force}, batch_size=[1])
    assert body_contact(NONE, td).item() == ("foot" not in region)


@pytest.mark.parametrize(("angle", "expected"), [(0.99, False), (1.01, True), (-1.01, True)])
def test_tilt_beyond_the_angle_counts(angle, expected):
    wxyz = Rotation.from_euler("y", angle).as_quat()[[3, 0, 1, 2]]
    td = TensorDict({"base_orientation": torch.tensor(wxyz)[None]}, batch_size=[1])
    assert tilted(NONE, td, angle=1.0).item() == expected


@pytest.mark.parametrize(("height", "expected"), [(0.16, False), (0.14, True)])
def test_center_of_mass_below_the_height_counts(height, expected):
    td = TensorDict({"com_position": torch.tensor([[0.0, 0.0, height]])}, batch_size=[1])
    assert low(NONE, td, height=0.15).item() == expected


@pytest.mark.parametrize(("height", "expected"), [(0.04, True), (0.3, False), (0.6, True)])
def test_base_outside_its_heights_counts(height, expected):
    td = TensorDict({"base_position": torch.tensor([[0.0, 0.0, height]])}, batch_size=[1])
    assert base_height(NONE, td, lowest=0.05, highest=0.5).item() == expected
