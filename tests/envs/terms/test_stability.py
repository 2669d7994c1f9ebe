"""Capture point and zero-moment point against the floor's forces, and by hand."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.terms.stability import (
    capture_point_in_base,
    centered_zero_moment_point,
    instantaneous_capture_point,
    zero_moment_point,
)
from zfall.envs.terms.support import distance_inside, sole_corners, support_hull
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import MomentumRate
from zfall.robots import ZEROTH01

NONE = TensorDict(batch_size=[1])
WEIGHT = 3.3494 * 9.81


def center_of_pressure(td) -> torch.Tensor:
    """Mean of the soles' corners by their vertical forces ``(N, 2)`` [m; world]."""
    load = td["feet_corner_force"].flatten(1)[..., None]
    corners = sole_corners(td, ZEROTH01)[..., :2].flatten(1, 2)
    return (load * corners).sum(1) / load.sum(1)


def test_all_points_are_one_when_the_robot_stands_still():
    """Nothing moves: CoP, projection of the CoM, capture point and ZMP coincide within 1 mm."""
    base = HumanoidEnv(num_envs=2, control_dt=0.04, physics_dt=0.005)
    action = JointPositionTarget(base, scale=1.0)
    env = make_env(base, {"action": action, "momentum": MomentumRate(base)})
    td = env.reset()
    for _ in range(75):  # 3 s
        td["action"] = torch.zeros(2, 20)
        td = env.step(td)["next"]
    load = td["feet_force"][..., 2].sum(-1)
    assert_close(load, torch.full((2,), WEIGHT), rtol=0.005, atol=0)
    below = td["com_position"][:, :2]
    hull = support_hull(td, ZEROTH01)
    points = {
        "cop": center_of_pressure(td),
        "capture": instantaneous_capture_point(td),
        "zmp": zero_moment_point(td, ZEROTH01.mass),
    }
    for name, point in points.items():
        assert (point - below).norm(dim=-1).max() < 0.001, name
        assert (distance_inside(hull, point) > 0.02).all(), name


def test_zero_moment_point_is_the_center_of_pressure_of_a_robot_that_moves():
    """The law that defines it, at every physics step of 1 ms: the floor is all that pushes."""
    base = HumanoidEnv(num_envs=4, control_dt=0.001, physics_dt=0.001)
    base.set_seed(0)
    action = JointPositionTarget(base, scale=1.0)
    env = make_env(base, {"action": action, "momentum": MomentumRate(base)})
    td = env.reset()
    side = torch.zeros(4, 20)
    side[:2, [1, 5, 7, 11]] = torch.tensor([[0.12], [-0.2]])  # sway by hips and ankles
    side[2:, [2, 4, 8, 10]] = torch.tensor([[0.15], [-0.15]])  # bow and straighten up
    found, expected = [], []
    for step in range(400):
        td["action"] = side * math.sin(2 * math.pi * 2.0 * step * 0.001)
        pressure, loaded = center_of_pressure(td), td["feet_force"][..., 2].sum(-1)
        com = td["com_position"]
        td = env.step(td)["next"]  # its momenta are those after the step that td's forces are of
        if step > 1:
            known = (loaded > 0.3 * WEIGHT)[:, None]
            at = td.select("momentum_rate", "angular_momentum_rate").set("com_position", com)
            found.append(torch.where(known, zero_moment_point(at, ZEROTH01.mass), 0.0))
            expected.append(torch.where(known, pressure, 0.0))
    found, expected = torch.stack(found, 1), torch.stack(expected, 1)
    assert (expected[:2, :, 1].std(1) > 0.01).all()  # it does move, sideways and lengthwise
    assert (expected[2:, :, 0].std(1) > 0.01).all()
    assert_close(found, expected, atol=3e-4, rtol=0)


def test_zero_moment_point_by_hand():
    """F = 0.5 + 32.858 N; x = 0.02 - (0.22 1 + 0.05) / F, y = 0.01 - (0.22 (-2) - 0.03) / F."""
    td = TensorDict(
        {
            "com_position": torch.tensor([[0.02, 0.01, 0.22]]),
            "momentum_rate": torch.tensor([[1.0, -2.0, 0.5]]),
            "angular_momentum_rate": torch.tensor([[0.03, 0.05, 9.0]]),
            "feet_position": torch.tensor([[[0.011906, 0.09, 0.3], [0.011906, -0.01591, 0.0]]]),
        },
        [1],
    )
    point = zero_moment_point(td, 3.3494)
    assert_close(point, torch.tensor([[0.011906, 0.024090]]), atol=1e-6, rtol=0)
    # The middle of the feet is at y = 0.037045, 0.012955 m away.
    value = centered_zero_moment_point(NONE, td, robot=ZEROTH01, cutoff=0.012955, epsilon=0.01)
    assert value.item() == pytest.approx(0.01, rel=1e-3)


def test_zero_moment_point_of_a_robot_in_flight_is_below_its_center_of_mass():
    td = TensorDict(
        {
            "com_position": torch.tensor([[0.3, -0.2, 0.5]]),
            "momentum_rate": torch.tensor([[0.0, 0.0, -WEIGHT]]),
            "angular_momentum_rate": torch.zeros(1, 3),
        },
        [1],
    )
    assert_close(zero_moment_point(td, 3.3494), torch.tensor([[0.3, -0.2]]))


def leaning(heading: float, speed: float) -> TensorDict:
    """The center of mass 6 mm behind a base that looks to ``heading``, moving ahead."""
    cos, sin = math.cos(heading), math.sin(heading)
    return TensorDict(
        {
            "base_position": torch.tensor([[1.0, 2.0, 0.33]]),
            "base_orientation": torch.tensor(
                [[math.cos(heading / 2), 0, 0, math.sin(heading / 2)]]
            ),
            "com_position": torch.tensor([[1.0 - 0.006 * cos, 2.0 - 0.006 * sin, 0.22]]),
            "com_velocity": torch.tensor([[speed * cos, speed * sin, 0.0]]),
        },
        [1],
    )


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.0])
def test_capture_point_counts_from_the_base_and_its_reference(heading):
    """At rest it is 6 mm behind the base as in the standing pose; 0.3 m/s move it by 44.9 mm."""
    values = {"robot": ZEROTH01, "epsilon": 0.01}
    still = capture_point_in_base(NONE, leaning(heading, 0.0), cutoff=0.01, **values)
    assert still.item() == pytest.approx(1.0, abs=1e-3)
    ahead = 0.3 * math.sqrt(0.22 / 9.81)
    moving = capture_point_in_base(NONE, leaning(heading, 0.3), cutoff=ahead, **values)
    assert moving.item() == pytest.approx(0.01, rel=0.03)
