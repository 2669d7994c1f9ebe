"""Mean velocities of a control step."""

import math

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import MeanVelocity


def test_odometry_goes_on_through_a_half_turn(make_base, play, looking):
    """3.0 rad, then -3.1 rad: 0.1832 rad to the left in 0.04 s, and 2 cm ahead and 1 cm to the right."""
    heading = torch.tensor([[3.0, 0.0], [-3.1, 0.0]])
    place = torch.tensor([[[5.0, 1.0, 0.3], [0, 0, 0]], [[5.02, 0.99, 0.5], [0, 0, 0.0]]])
    frames = [
        {"base_position": p, "base_orientation": looking(h)}
        for p, h in zip(place, heading, strict=True)
    ]
    td = play(MeanVelocity(make_base(num_envs=2)), frames)[-1]
    turn = (2 * math.pi - 6.1) / 0.04
    expected = torch.tensor([[0.5, -0.25, turn], [0.0, 0.0, 0.0]])
    assert_close(td["odometry_velocity"], expected, atol=1e-4, rtol=1e-4)
    assert_close(td["base_mean_angular_velocity"][:, 2], expected[:, 2], atol=1e-4, rtol=1e-4)


def test_angular_velocity_is_that_of_a_steady_turn_about_any_axis(make_base, play):
    rate = 3.0 * torch.randn(50, 3)  # [rad/s; body]
    old = Rotation.random(50, random_state=0)
    new = old * Rotation.from_rotvec(0.04 * rate.numpy())
    frames = [
        {
            "base_position": torch.zeros(50, 3),
            "base_orientation": torch.tensor(r.as_quat()[:, [3, 0, 1, 2]]).float(),
        }
        for r in (old, new)
    ]
    td = play(MeanVelocity(make_base(num_envs=50)), frames)[-1]
    assert_close(td["base_mean_angular_velocity"], rate, atol=1e-4, rtol=1e-3)


def test_means_are_those_of_what_the_physics_goes_through(make_base):
    base = make_base(num_envs=3)
    base.record_substeps(["base_angular_velocity", "base_linear_velocity"])
    env = make_env(
        base, {"action": JointPositionTarget(base, scale=1.0), "mean": MeanVelocity(base)}
    )
    check_env_specs(env)
    seen = {}
    step = base._step
    base._step = lambda td: seen.update(out=step(td)) or seen["out"].clone()
    td = env.reset()
    assert not td["odometry_velocity"].any()
    for _ in range(10):
        td["action"] = 0.1 * torch.randn(3, 20)
        td = env.step(td)["next"]
        steps = seen["out"]["substeps"]
        linear = steps["base_linear_velocity"].mean(1)
        assert_close(td["odometry_velocity"][:, :2], linear[:, :2], atol=1e-4, rtol=0)
        turning = steps["base_angular_velocity"].mean(1)
        np.testing.assert_allclose(td["base_mean_angular_velocity"], turning, atol=0.02)
