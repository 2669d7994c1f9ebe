"""From action to target."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget


def test_target_is_reference_plus_scaled_action_within_the_ranges(make_task):
    env = make_task({"action": (JointPositionTarget, {"scale": 0.5})})
    check_env_specs(env)
    td = env.reset()
    base = env.base_env
    assert_close(td["target"], base.stand_position.expand(4, -1))
    td["action"] = torch.zeros(4, 20)
    td["action"][:, 3], td["action"][:, 9] = 0.2, 100.0
    target = env.step(td)["next", "target"][0]
    assert target[3].item() == pytest.approx(-0.8 + 0.1)  # right knee, bent by 0.8 in the reference
    assert target[9].item() == pytest.approx(1.396263)  # left knee, at its published stop
    assert_close(target[[0, 15]], torch.zeros(2))


def test_scale_must_be_positive(make_base):
    with pytest.raises(ValueError, match=r"scale must be positive, got 0"):
        JointPositionTarget(make_base(), scale=0)
