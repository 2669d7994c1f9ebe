"""Targets by the names of joints."""

import pytest
import torch
from torch.testing import assert_close

from zfall.envs.make import make_env
from zfall.envs.transforms.foreign import ForeignJointTarget

JOINTS = ["left_knee_pitch", "right_hip_pitch"]


def test_the_target_is_the_reference_and_the_scaled_action_within_the_joints_range(make_base):
    base = make_base(num_envs=1)
    action = ForeignJointTarget(base, joints=JOINTS, scale=[0.5, 2.0], reference={JOINTS[0]: 0.1})
    env = make_env(base, {"action": action})
    td = env.step(env.reset().set("action", torch.tensor([[0.2, 100.0]])))["next"]
    expected = base.stand_position.clone()
    knee, hip = (base.robot.joints.index(name) for name in JOINTS)
    expected[knee] = 0.1 + 0.5 * 0.2
    expected[hip] = base.joint_range[hip, 1]  # 200 rad is beyond
    assert_close(td["target"][0], expected)


def test_the_bounds_of_the_action_lead_to_the_ends_of_the_range(make_base):
    base = make_base(num_envs=2)
    env = make_env(base, {"action": ForeignJointTarget(base, joints=JOINTS, scale=[0.5, -2.0])})
    places = [base.robot.joints.index(name) for name in JOINTS]
    for end in (env.action_spec.space.low, env.action_spec.space.high):
        target = env.step(env.reset().set("action", end))["next", "target"][:, places]
        ends = base.joint_range[places].expand(2, -1, -1)
        assert torch.isclose(target[..., None], ends).any(-1).all()


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"joints": ["tail"], "scale": 1.0}, "joints.*tail"),
        ({"joints": JOINTS, "scale": [1.0]}, "scale.*2 joints.*got 1"),
        ({"joints": JOINTS, "scale": 0.0}, "scale.*not be 0"),
        ({"joints": [JOINTS[0]] * 2, "scale": 1.0}, "joints.*once.*left_knee_pitch"),
        ({"joints": JOINTS, "scale": 1.0, "reference": {"tail": 0.0}}, "reference.*tail"),
    ],
)
def test_what_does_not_fit_is_refused(make_base, values, match):
    with pytest.raises(ValueError, match=match):
        ForeignJointTarget(make_base(), **values)
