"""Walking terms by hand."""

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.terms.walking import (
    feet_air_time,
    forward_velocity,
    heading_as_commanded,
    lateral_velocity,
    velocity_as_commanded,
)

NONE = TensorDict(batch_size=[1])


def moving(velocity: list[float], sequence: str = "z", degrees: float = 0.0) -> TensorDict:
    """A base that moves along world axes, turned about one of its own."""
    wxyz = Rotation.from_euler(sequence, degrees, degrees=True).as_quat()[[3, 0, 1, 2]]
    values = {"base_linear_velocity": [velocity], "base_orientation": [wxyz.tolist()]}
    return TensorDict({key: torch.tensor(value) for key, value in values.items()}, [1])


@pytest.mark.parametrize(
    ("td", "forward", "lateral"),
    [
        (moving([0.1, -0.3, 0.0]), 0.1, 0.3),
        (moving([0.1, -0.3, 0.0], "z", 90), -0.3, 0.1),  # it faces the world's y
        (moving([0.1, -0.3, 0.0], "z", 180), -0.1, 0.3),
        (moving([0.0, 0.0, -0.15], "y", 90), 0.15, 0.0),  # face down: down is forward
        (moving([0.7, 0.0, 0.0]), 0.2, 0.0),  # no more than the limit
        (moving([-0.7, 0.0, 0.0]), -0.7, 0.0),
    ],
)
def test_velocities_are_those_of_the_robot(td, forward, lateral):
    assert forward_velocity(NONE, td, limit=0.2).item() == pytest.approx(forward, abs=1e-6)
    assert lateral_velocity(NONE, td).item() == pytest.approx(lateral, abs=1e-6)


def test_air_time_is_paid_at_touchdown():
    """Worlds: left lands after 0.5 s; both land; still in the air; takes off; on the floor."""
    before = torch.tensor([[0.5, 0.0], [0.3, 0.1], [0.2, 0.0], [0.0, 0.0], [0.0, 0.0]])
    after = torch.tensor([[0.0, 0.0], [0.0, 0.0], [0.22, 0.0], [0.02, 0.0], [0.0, 0.0]])
    td, next_td = (TensorDict({"feet_air_time": t}, [5]) for t in (before, after))
    expected = torch.tensor([0.1, -0.4, 0.0, 0.0, 0.0])
    assert_close(feet_air_time(td, next_td, threshold=0.4)[:, 0], expected)


def test_walking_as_commanded_is_paid_along_the_robots_own_axes():
    """Off by 0.1 m/s with a cutoff of 0.2 m/s: 0.01^(0.1^2 / 0.2^2) = 0.01^0.25 = 0.3162."""
    told = TensorDict({"command": torch.tensor([[0.1, 0.0, 0.5, 0, 0, 0]])}, [1])
    given = {"cutoff": 0.2, "epsilon": 0.01}
    facing_left = moving([0.0, 0.2, 0.0], "z", 90)
    assert velocity_as_commanded(told, facing_left, **given).item() == pytest.approx(
        0.3162, abs=1e-4
    )
    ahead = moving([0.1, 0.0, 0.0])
    assert velocity_as_commanded(told, ahead, **given).item() == pytest.approx(1.0)


def test_the_heading_is_compared_the_short_way_round():
    """179 and -171 degrees are 10 apart: 0.01^(10^2 / 20^2) = 0.3162 with a cutoff of 20."""
    td = moving([0.0, 0.0, 0.0], "z", 179)
    td["commanded_heading"] = torch.tensor([[-171.0]]).deg2rad()
    paid = heading_as_commanded(NONE, td, cutoff=torch.pi / 9, epsilon=0.01)
    assert paid.item() == pytest.approx(0.3162, abs=1e-4)
