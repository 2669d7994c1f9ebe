"""Where movements that catch a fall are stored, and which of them is for which fall."""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from zfall.falling.movements import Catches, load_catches, save_catches
from zfall.robots import ZEROTH01

NEVER = torch.inf


@pytest.fixture
def stored(tmp_path):
    postures = torch.zeros(12, 2, 3, 20)
    postures[..., 4] = torch.arange(72.0).reshape(12, 2, 3)
    path = tmp_path / "catches.npz"
    save_catches(path, postures, torch.tensor([0.1, 0.2, NEVER]), torch.tensor([1.5]))
    return load_catches(ZEROTH01, path)


def test_what_is_written_is_read(stored):
    assert stored.postures.shape == (12, 2, 3, 20)
    assert_close(stored.postures[3, 1, :, 4], torch.tensor([21.0, 22.0, 23.0]))
    assert_close(stored.until, torch.tensor([0.1, 0.2, NEVER]))
    assert_close(stored.speeds, torch.tensor([1.5]))


@pytest.mark.parametrize(
    ("degrees", "speed", "number"),
    [(0, 1.0, 0), (14, 1.6, 1), (-14, 1.0, 0), (16, 1.0, 2), (90, 2.0, 7), (-30, 1.0, 22), (-179, 2.0, 13)],
)  # fmt: skip
def test_nearest_heading_and_bin_of_speed(stored, degrees, speed, number):
    """Sector 30 degrees wide times 2 bins: 90 degrees and fast is 3 x 2 + 1."""
    way = torch.tensor([math.radians(degrees)])
    assert stored.nearest(speed * way.cos(), speed * way.sin()).item() == number


def test_one_bin_of_speed():
    only = Catches(torch.zeros(12, 1, 1, 20), torch.tensor([NEVER]), torch.zeros(0))
    assert only.nearest(torch.tensor([0.0]), torch.tensor([9.0])).item() == 3


def test_a_file_of_another_robot_is_refused(tmp_path):
    path = tmp_path / "catches.npz"
    with pytest.raises(ValueError, match="there is no"):
        load_catches(ZEROTH01, path)
    np.savez(path, postures=np.zeros((12, 1, 1, 3)), until=[np.inf], speeds=[])
    with pytest.raises(ValueError, match="catches must be of zeroth01, .* other joints"):
        load_catches(ZEROTH01, path)


def test_stored_movements_stay_within_the_joint_ranges(make_base):
    low, high = make_base(num_envs=1).joint_range.unbind(-1)
    postures = load_catches(ZEROTH01).postures
    assert ((postures >= low - 1e-6) & (postures <= high + 1e-6)).all()
