"""What the servos are told, and what they were told before an episode begins."""

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.transforms.actions import (
    ActuatorDelay,
    Backlash,
    Deadband,
    JointPositionTarget,
    JointVelocityTarget,
    LowPass,
    ServoPlanner,
)

GIVEN, JOINTS = 0.2, 0.1  # [rad]


@pytest.mark.parametrize(
    ("cls", "values", "where", "otherwise"),
    [
        (ActuatorDelay, {"delay": (0.0, 0.008)}, "history", JOINTS),
        (Backlash, {"width": 0.01}, "level", JOINTS),
        (Deadband, {"width": 0.01}, "level", JOINTS),
        (JointPositionTarget, {"scale": 1.0}, None, None),
        (JointVelocityTarget, {"limit": 1.0}, "position", JOINTS),
        (LowPass, {"time_constant": 0.05}, "level", JOINTS),
        (ServoPlanner, {"velocity": 6.0, "acceleration": 60.0}, "position", JOINTS),
    ],
)
def test_a_recorded_fall_begins_with_the_target_it_had(make_base, cls, values, where, otherwise):
    """World 0 in a fall, world 1 not: there it is the joints' angles, or the reference."""
    env = make_base(num_envs=2)
    transform = cls(env, **values)
    given = torch.full((2, 20), GIVEN)
    given[1] = torch.nan
    joints = TensorDict({"joint_position": torch.full((2, 20), JOINTS)}, [2])
    after = transform._reset(TensorDict({"start": {"target": given}}, [2]), joints)
    begins = (after["target"] if where is None else getattr(transform, where)).clone()
    begins = begins.reshape(2, -1, 20)
    low, high = env.joint_range.unbind(-1)
    expected = torch.full((20,), GIVEN)
    other = env.stand_position if otherwise is None else torch.full((20,), otherwise)
    if cls is JointVelocityTarget:  # keeps within the ranges
        expected, other = expected.clamp(low, high), other.clamp(low, high)
    assert torch.equal(begins[0], expected.expand_as(begins[0]))
    assert torch.equal(begins[1], other.expand_as(begins[1]))
