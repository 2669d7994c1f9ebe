"""When a robot stands again."""

import math

import pytest
import torch
from tensordict import TensorDict

from zfall.falling.standing import stands
from zfall.robots import ZEROTH01

REGIONS = list(ZEROTH01.regions)


@pytest.mark.parametrize(
    ("lean", "height", "touches", "answer"),
    [
        (0.0, 1.0, ["left_foot", "right_foot"], True),
        (0.34, 0.81, ["left_foot"], True),
        (0.36, 1.0, ["left_foot", "right_foot"], False),
        (0.0, 0.79, ["left_foot", "right_foot"], False),
        (0.0, 1.0, [], False),  # in the air
        (0.0, 1.0, ["left_foot", "right_hand"], False),
    ],
)
def test_it_stands_upright_and_high_on_its_feet_alone(lean, height, touches, answer):
    force = torch.zeros(2, len(REGIONS))
    force[0, [REGIONS.index(region) for region in touches]] = 1.0
    force[1, -2:] = 1.0  # another world, which stands
    orientation = torch.tensor([[math.cos(lean / 2), 0.0, math.sin(lean / 2), 0.0], [1, 0, 0, 0]])
    com = torch.tensor([[0.0, 0.0, height], [0.0, 0.0, 1.0]]) * ZEROTH01.com_height
    td = {"contact_force_peak": force, "base_orientation": orientation, "com_position": com}
    assert stands(TensorDict(td, batch_size=[2]), ZEROTH01).tolist() == [answer, True]
