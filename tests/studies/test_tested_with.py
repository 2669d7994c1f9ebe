"""A class of the user's own in the place of what a row's policy is tested with."""

from typing import ClassVar

import pytest
import torch
from rich.console import Console
from tensordict.nn import TensorDictModuleBase

from zfall.studies.tested_with import build_tested_with

STEADY = "tests.studies.test_tested_with.Steady"


class Constant(TensorDictModuleBase):
    """Acts with one value, whatever it sees."""

    in_keys: ClassVar = ["observation"]
    out_keys: ClassVar = ["action"]

    def __init__(self, value: float, size: int):
        super().__init__()
        self.value, self.size = value, size

    def forward(self, tensordict):
        return tensordict.set("action", torch.full((*tensordict.shape, self.size), self.value))


class Steady:
    """Keeps the row's policy from acting at all."""

    trainings: ClassVar = []

    def __init__(self, *, value: float = 0.0):
        self.value = value

    def fingerprint(self):
        return self.value

    def check(self, row, others, env):
        if self.value > 1.0:
            raise ValueError(f"value must be at most 1, got {self.value}.")

    def actor(self, policy, others):
        assert others == []
        return Constant(self.value, policy.env().action_spec.shape[-1])


@pytest.mark.long
def test_a_row_is_tested_with_it_and_trained_without(tiny, tmp_path):
    """Targets that never move are smooth; the trained policy's are not."""
    rows, steady = {"alone": [], "steady": []}, {"steady": {"_target_": STEADY}}
    study = tiny(rows=rows, seeds=[0], tested_with=steady)
    table = study.run(results=tmp_path, runs=tmp_path / "runs", console=Console(quiet=True))
    smooth = table[table["figure"] == "target_smoothness"].set_index("row")["mean"]
    assert smooth["steady"] < 1e-5 < smooth["alone"]
    assert len(list((tmp_path / "runs").glob("*/checkpoints"))) == 1


def test_results_with_another_fingerprint_are_others(tiny):
    rows = {"none": [], "zero": [], "half": []}
    tested_with = {"zero": {"_target_": STEADY}, "half": {"_target_": STEADY, "value": 0.5}}
    names = [run.tests[0].name for run in tiny(rows=rows, seeds=[0], tested_with=tested_with).plan]
    assert len(set(names)) == 3


def test_what_it_refuses_is_refused_before_training(tiny):
    study = tiny(tested_with={"none": {"_target_": STEADY, "value": 2.0}})
    with pytest.raises(ValueError, match=r"study.tested_with.none: value .* 2\.0"):
        _ = study.plan


def test_a_class_of_another_shape_is_refused():
    table = {"_target_": "tests.studies.test_tested_with.Constant", "value": 0.0, "size": 1}
    with pytest.raises(ValueError, match="_target_ .*Constant"):
        build_tested_with(table)
