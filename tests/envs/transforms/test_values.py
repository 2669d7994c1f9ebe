"""Numbers that may differ from world to world."""

import pytest
import torch

from zfall.envs.transforms.values import check_not_negative, per_world


def test_numbers_pass_and_values_of_worlds_get_dimensions_behind():
    assert per_world(0.5, 3) == 0.5
    assert per_world(torch.tensor(0.5), 3).shape == ()
    each = torch.tensor([1.0, 2.0])
    assert (torch.ones(2, 4, 5) * per_world(each, 3))[1].sum() == 40.0


def test_negative_value_is_refused_with_its_key():
    with pytest.raises(ValueError, match=r"std.gyro must not be negative, got nan"):
        check_not_negative("std", {"accelerometer": 0.0, "gyro": float("nan")})
