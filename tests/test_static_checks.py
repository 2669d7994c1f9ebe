"""What a config may give to classes that are not ours, as their annotations allow it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import pytest
import torch
from tensordict import NestedKey
from torch import nn
from torchrl.envs import EnvBase

from zfall.complaints import complaint
from zfall.robots import Robot
from zfall.static_checks import check_nodes

T = TypeVar("T")
MODULE = {"_target_": "torch.nn.Tanh"}


class Own(nn.Module):
    """As a user writes one: what it takes is said by classes of torch and TorchRL."""

    def __init__(
        self,
        inner: nn.Module,
        in_keys: Sequence[NestedKey],
        *,
        key: NestedKey,
        dtype: torch.dtype | None = None,
        activation: Callable[[torch.Tensor], torch.Tensor] | None = None,
        size: int = 1,
    ) -> None:
        super().__init__()


class Late:
    """Its annotations are text, one of them a name that is nowhere."""

    def __init__(self, spec: "Nowhere", size: "int" = 1, *, env: "EnvBase") -> None:  # noqa: F821
        """Takes anything."""


def node(target: type, **values: Any) -> dict[str, Any]:
    return {"_target_": f"{__name__}.{target.__name__}", **values}


@pytest.mark.parametrize(
    "given",
    [
        node(Own, key="a", in_keys=["observation"]),
        node(Own, key=["agent", "observation"], in_keys=["a", ["b", "c"]]),
        node(Own, key="a", in_keys=["a"], inner=MODULE),
        node(Own, key="a", in_keys=["a"], dtype="float32"),
        node(
            Own, key="a", in_keys=["a"], dtype={"_target_": "hydra.utils.get_object", "path": "x"}
        ),
        node(Own, key="a", in_keys=["a"], activation=MODULE),
        node(Own, key="a", in_keys=["a"], activation=MODULE | {"_partial_": True}),
        node(Own, key="a", in_keys=["a"], activation=None),
        node(Late, spec=3, size="x", env="humanoid"),
        {"_target_": "torchrl.envs.CatFrames", "N": 2, "dim": -1, "in_keys": ["observation"]},
        {"_target_": "torchrl.envs.CatTensors", "in_keys": ["a", ["b", "c"]], "out_key": "d"},
        {"_target_": "torchrl.modules.MLP", "out_features": 3, "num_cells": [8, 8]},
        {"_target_": "torch.nn.Linear", "in_features": 2, "out_features": 3, "dtype": None},
        {"_target_": "torch.nn.Sequential", "_args_": [MODULE, MODULE]},
    ],
)
def test_what_other_classes_take_is_taken(given):
    check_nodes({"own": given})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (node(Own, key="a", in_keys="observation"), r"own.in_keys .*\[observation\], got observ"),
        (node(Own, key="a", in_keys=["a"], size="x"), "own.size must be a whole number, got x"),
        (node(Own, key="a", in_keys=["a"], activation=3), "own.activation .* got 3"),
        (node(Own, key="a", in_keys=["a"], dtyp=3), "own.dtyp is not .* did you mean dtype"),
        ({"_target_": "torchrl.envs.CatFrames", "N": "x", "dim": -1}, "own.N .*number, got x"),
    ],
)
def test_what_plain_annotations_rule_out_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        check_nodes({"own": given})


@pytest.mark.parametrize("value", [None, True, 3, 0.5, "x", ["a", ["b"]], {"a": 1}, MODULE])
@pytest.mark.parametrize(
    "kind",
    [NestedKey, torch.dtype, torch.Tensor, nn.Module, type[nn.Module], EnvBase, T, "Nowhere"],
    ids=str,
)
def test_an_annotation_that_is_not_ours_and_not_plain_takes_anything(kind, value):
    assert complaint(value, kind, "a") is None


def test_lists_and_tables_without_a_kind_take_any_number_of_values():
    for kind in (tuple, list, Sequence, tuple[NestedKey, ...], Sequence[T]):
        for value in ([], ["a"], ["a", "b", "c"]):
            assert complaint(value, kind, "a") is None
    assert complaint({"a": "x", "b": MODULE}, Mapping[str, nn.Module], "a") is None


def test_one_of_our_classes_is_given_by_a_table():
    assert complaint({"_target_": "zfall.robots.Robot"}, Robot, "robot") is None
    assert complaint(3, Robot, "robot") == (
        "robot must be a table with a _target_ that makes a Robot, got 3."
    )
