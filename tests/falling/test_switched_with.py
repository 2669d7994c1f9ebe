"""What a study tests a policy with: another one, switched by the mode machine."""

import re
from typing import ClassVar

import pytest
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from zfall.configs import compose_config
from zfall.falling import switched_with
from zfall.falling.switched_with import SwitchedWith
from zfall.policies import Policy


class Says(TensorDictModuleBase):
    """Acts with one value."""

    in_keys: ClassVar = ["observation"]
    out_keys: ClassVar = ["action"]

    def __init__(self, value: float):
        super().__init__()
        self.value = value

    def forward(self, td):
        return td.set("action", torch.full((*td.shape, 1), self.value))


@pytest.mark.parametrize(
    ("mode", "expected"), [("recover", [2.0, 1.0, 1.0]), ("kneel", [1.0, 2.0, 2.0])]
)
def test_each_of_two_policies_acts_in_its_own_mode(mode, expected):
    """The row's says 1 and the other one 2, in RECOVER, KNEEL and STABLE."""
    config = OmegaConf.create({"env": {}})
    one, two = (Policy("", Says(value), config, "") for value in (1.0, 2.0))
    actor = SwitchedWith(**{mode: ["experiment=any"]}).actor(one, [two])
    td = TensorDict({"observation": torch.zeros(3, 4), "mode": torch.eye(3)}, [3])
    assert actor(td)["action"][:, 0].tolist() == expected


@pytest.mark.parametrize(
    ("given", "key", "value"),
    [
        ({}, "recover", "neither"),
        ({"recover": "script"}, "recover", "script"),
        ({"recover": "best", "kneel": "script"}, "recover and kneel", "best"),
        ({"kneel": 5}, "kneel", "5"),
        ({"kneel": []}, "kneel", r"\[\]"),
        ({"recover": "nope"}, "recover", "nope"),
    ],
)
def test_what_is_no_policy_is_refused(given, key, value):
    with pytest.raises(ValueError, match=f"{key}.*{value}"):
        SwitchedWith(**given)


def test_a_world_without_modes_is_refused():
    cfg = compose_config(["experiment=quickstart"])
    with pytest.raises(ValueError, match=re.escape("transforms.mode.initial") + ".*None"):
        SwitchedWith(kneel="script").check(cfg, [], cfg.env)


def test_a_policy_that_sees_something_else_is_refused():
    row, world = (
        compose_config([f"experiment={name}"]) for name in ("quickstart", "push_to_kneel")
    )
    with pytest.raises(ValueError, match="recover must have the same env.transforms.observation"):
        SwitchedWith(recover="best").check(row, [], world.env)
    SwitchedWith(recover=["any"]).check(row, [row], world.env)
    SwitchedWith(kneel="script").check(row, [], world.env)


def test_results_depend_on_what_the_files_of_a_partner_hold(monkeypatch, tmp_path):
    script, policy = SwitchedWith(kneel="script"), SwitchedWith(recover="best")
    before = script.fingerprint(), policy.fingerprint()
    other = tmp_path / "catches.npz"
    other.write_bytes(b"other movements")
    monkeypatch.setattr(switched_with, "MOVEMENTS", other)
    assert script.fingerprint() != before[0]
    assert policy.fingerprint() == before[1]
