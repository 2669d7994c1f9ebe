"""Displacements against a list of all poses, and by hand."""

import math

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.windows import OdometryDisplacement


def test_displacement_is_that_of_a_list_of_poses_with_resets_in_between(make_base, play, looking):
    """Windows of 7 steps, 60 steps, three worlds of which one or another begins anew."""
    torch.manual_seed(1)
    position, heading = 0.1 * torch.randn(60, 3, 3).cumsum(0), 0.3 * torch.randn(60, 3).cumsum(0)
    resets = {k: torch.rand(3) < 0.5 for k in (3, 12, 13, 30, 45)}
    frames = [
        {"base_position": p, "base_orientation": looking(h)}
        for p, h in zip(position, heading, strict=True)
    ]
    transform = OdometryDisplacement(make_base(num_envs=3), seconds=0.28)
    found = torch.stack([td["odometry_displacement"] for td in play(transform, frames, resets)])
    pose = torch.cat([position[..., :2], heading[..., None]], -1)
    for world in range(3):
        begin = 0
        for k in range(60):
            if k in resets and resets[k][world]:
                begin = k
            expected = pose[k, world] - pose[max(k - 7, begin), world]
            expected[2] = math.remainder(expected[2], 2 * math.pi)
            assert_close(found[k, world], expected, atol=1e-5, rtol=0, msg=f"{world} {k}")


def test_specs_hold_and_a_window_shorter_than_a_step_is_refused(make_task, make_base):
    from zfall.envs.transforms.actions import JointPositionTarget

    check_env_specs(make_task({
        "action": (JointPositionTarget, {"scale": 1.0}),
        "gone": (OdometryDisplacement, {"seconds": 0.2}),
    }))  # fmt: skip
    with pytest.raises(ValueError, match=r"seconds must be at least control_dt 0.04, got 0.01"):
        OdometryDisplacement(make_base(), seconds=0.01)
