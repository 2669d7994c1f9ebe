"""Vectors in units of ranges."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import NormalizedVector, ObservationNoise

KEYS = ["joint_position", "base_position", "feet_contact"]


def vector(base, **more: object) -> NormalizedVector:
    values = {"keys": KEYS, "ranges": {"joint_position": "joint_range"}, "out_key": "observation"}
    return NormalizedVector(base, **(values | more))


@pytest.mark.parametrize(("onto", "ends"), [([-1, 1], (-1.0, 0.0, 1.0)), ([0, 1], (0.0, 0.5, 1.0))])
def test_ends_and_middle_of_the_ranges_go_to_those_of_the_interval(make_base, onto, ends):
    base = make_base(num_envs=3)
    low, high = base.joint_range.unbind(-1)
    ranges = {"joint_position": "joint_range", "base_position": [-2.0, 6.0]}
    td = TensorDict(
        {
            "joint_position": torch.stack([low, (low + high) / 2, high]),
            "base_position": torch.tensor([[-2.0], [2.0], [6.0]]).expand(3, 3),
            "feet_contact": torch.tensor([[True, False]]).expand(3, 2),
        },
        [3],
    )
    out = vector(base, ranges=ranges, onto=onto)._call(td)["observation"]
    expected = torch.tensor(ends)[:, None].expand(3, 23)
    assert_close(out[:, :23], expected, atol=1e-6, rtol=0)
    assert out[:, 23:].tolist() == [[1.0, 0.0]] * 3  # without a range: as it is


def test_it_takes_what_is_measured_and_cuts_nothing_off(make_base):
    base = make_base(num_envs=2)
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std={"base_position": 10.0}),
        "vector": vector(base, ranges={"base_position": [-1.0, 1.0]}),
    })  # fmt: skip
    check_env_specs(env)
    td = env.reset()
    assert_close(td["observation"][:, 20:23], td["measured", "base_position"])
    assert td["observation"].abs().max() > 1.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ranges": {"com_position": [0, 1]}}, "ranges must name quantities of keys, got com_pos"),
        ({"ranges": {"base_position": [1, 1]}}, r"ranges.base_position must be \[low, high\]"),
        ({"ranges": {"base_position": "range"}}, r"or joint_range, got range"),
        ({"onto": [1.0, 1.0]}, "onto must be two different numbers"),
    ],
)
def test_bad_ranges_are_refused(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        vector(make_base(), **values)


def test_unknown_key_is_refused_with_a_list(make_base):
    base = make_base()
    unknown = vector(base, keys=["joint_positon"], ranges={})
    with pytest.raises(ValueError, match=r"\(.*joint_position.*\), got joint_positon"):
        make_env(base, {"vector": unknown})
