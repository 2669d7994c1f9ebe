"""Smallest errors against a list of all of them, and by hand."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import JointErrorMin


def test_minimum_is_that_of_a_list_with_resets_in_between(make_base, play):
    """Windows of 5 steps and both their ends; before a reset the error counts as 0."""
    torch.manual_seed(1)
    base = make_base(num_envs=3)
    size = torch.rand(50, 3)
    legs = torch.zeros(20)
    legs[7] = 1.0
    resets = {k: torch.rand(3) < 0.5 for k in (4, 5, 20, 31)}
    frames = [{"joint_position": base.stand_position + s[:, None] * legs} for s in size]
    transform = JointErrorMin(base, seconds=0.2)
    found = torch.stack([td["joint_error_min"] for td in play(transform, frames, resets)])[..., 0]
    for world in range(3):
        begin = 0
        for k in range(50):
            if k in resets and resets[k][world]:
                begin = k
            seen = size[max(k - 5, begin) : k + 1, world].min() if k >= begin + 5 else 0.0
            assert_close(found[k, world], torch.as_tensor(seen), atol=1e-6, rtol=0, msg=f"{k}")


@pytest.mark.parametrize(("joints", "expected"), [("legs", 0.1 * 12**0.5), ("all", 0.1 * 20**0.5)])
def test_error_is_the_norm_over_the_joints_asked_for(make_base, play, joints, expected):
    base = make_base(num_envs=2)
    frames = [{"joint_position": (base.stand_position + 0.1).expand(2, 20)}] * 3
    td = play(JointErrorMin(base, seconds=0.08, joints=joints), frames)[-1]
    assert_close(td["joint_error_min"], torch.full((2, 1), expected), atol=1e-6, rtol=0)


def test_specs_hold_and_bad_values_are_refused(make_task, make_base):
    check_env_specs(make_task({
        "action": (JointPositionTarget, {"scale": 1.0}),
        "error": (JointErrorMin, {"seconds": 0.2}),
    }))  # fmt: skip
    with pytest.raises(ValueError, match="seconds must be at least control_dt 0.04, got 0"):
        JointErrorMin(make_base(), seconds=0)
    with pytest.raises(ValueError, match="joints must be all or legs, got 'toes'"):
        JointErrorMin(make_base(), seconds=1.0, joints="toes")
