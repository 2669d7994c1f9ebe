"""Makers of what falls well: what they refuse, and what stands in for what they make."""

import re

import pytest
import torch
from rich.console import Console

from zfall import checkpoint
from zfall.falling.banks import PUSH_KEYS, SEEN_KEYS, load_bank
from zfall.falling.fall_network import load_fall_network
from zfall.falling.files import ASSETS, own_file
from zfall.falling.lying import POSTURES, load_lying
from zfall.falling.making import (
    LyingStates,
    RecordedFalls,
    SearchedCatches,
    SearchedRises,
    SwitchedPolicy,
    TrainedTrigger,
)
from zfall.policies import load_policy
from zfall.robots import ZEROTH01

NETWORK = str(ASSETS / "zeroth01_fall_network.pt")


def test_what_stands_in_is_read_as_what_is_made(tmp_path):
    TrainedTrigger(run="twin_25hz").stand_in(tmp_path / "trigger.pt")
    network = load_fall_network(str(tmp_path / "trigger.pt"))
    assert len(network.normalizer.mean) == 3 + 3 + 3 * len(ZEROTH01.joints)
    assert network.trained_with["control_dt"] == 0.04
    RecordedFalls(run="kneel").stand_in(tmp_path / "falls.npz")
    states = load_bank(tmp_path / "falls.npz", ZEROTH01, needs=(*PUSH_KEYS, *SEEN_KEYS))
    assert not states["push_left"].any()
    SearchedCatches(falls=str(tmp_path / "falls.npz")).stand_in(tmp_path / "catches.npz")
    LyingStates(run="kneel").stand_in(tmp_path / "lying.npz")
    assert load_lying(ZEROTH01, tmp_path / "lying.npz")["posture"].tolist() == [
        *range(len(POSTURES))
    ]
    SearchedRises(bank=str(tmp_path / "lying.npz")).stand_in(tmp_path / "rises.npz")


def test_a_policy_is_switched_by_the_network_and_the_movements_that_are_named(tmp_path):
    """In a table that has no predictor yet, too."""
    catches, rises = (str(own_file(ZEROTH01, f"{name}.npz")) for name in ("catches", "rises"))
    files = {"trigger": NETWORK, "catches": catches, "rises": rises}
    maker = SwitchedPolicy(
        recover="twin_25hz", env="push_to_stand", probability=0.7, hold=0.08, **files
    )
    maker.make(tmp_path / "both.pt", Console(quiet=True))
    policy = load_policy(tmp_path / "both.pt")
    table = policy.config.env.transforms
    assert (table.mode.probability, table.mode.hold) == (0.7, 0.08)
    assert table.predictor.network.path == NETWORK
    assert table.kneel_reference.catches == catches
    assert table.rise_reference.rises == rises
    env = policy.env()
    td = policy.actor(env.step_mdp(env.step(policy.actor(env.reset()))))
    assert td["fall_probability"].shape == (1, 1)
    twin = checkpoint.load(ASSETS.parents[1] / "policies" / "twin_25hz.pt")["policy"]
    assert all(torch.equal(maker.content["policy"][f"recover.{key}"], twin[key]) for key in twin)


@pytest.mark.parametrize(
    ("maker", "given", "says"),
    [
        (RecordedFalls, {"run": "twin_25hz", "world": "planar"}, "world .* got planar"),
        (
            TrainedTrigger,
            {"run": "twin_25hz", "world": "mars"},
            "battery must be one of .* got 'mars'",
        ),
        (SearchedCatches, {"falls": "none.npz"}, "falls must be a file .*none.npz"),
        (SearchedRises, {"bank": "none.npz"}, "bank must be a file .*none.npz"),
        (SwitchedPolicy, {"recover": "none.pt"}, "recover must be a run folder"),
    ],
)
def test_what_there_is_not_is_refused(maker, given, says):
    with pytest.raises(ValueError, match=re.compile(says)):
        maker(**given)
