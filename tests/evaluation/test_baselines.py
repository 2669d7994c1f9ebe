"""Baselines by name, in the worlds in which they can act."""

import pytest
import torch

from zfall.evaluation.baselines import baseline_names, load_baseline, passive
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.robots import ZEROTH01


def test_all_have_a_world_in_which_they_act(compose_config):
    """Those that hold still are first, as they fit everywhere."""
    names = baseline_names()
    assert names[:2] == ["pose_hold", "limp"]
    kneel = compose_config("env=push_to_kneel", "num_envs=2").env
    for name in names:
        baseline = load_baseline(name)
        assert baseline.fits(kneel), name
        assert baseline.world(kneel).base_env == kneel.base_env
        assert baseline.servos == (name != "limp")
    with pytest.raises(ValueError, match="baseline .*pose_hold.*got 'nobody'"):
        load_baseline("nobody")


def test_a_baseline_in_an_env_with_modes_holds_its_pose(compose_config):
    """Without an action its reference would go down as soon as the machine says KNEEL."""
    cfg = compose_config("env=push_to_kneel", "num_envs=2").env
    times = {"push_time": 0.2, "end_time": 1.0}
    battery = load_battery("planar", impulses=[1.0], starts=1, directions=2, **times)

    def moved(world):
        targets = []
        run_battery(
            battery, world, None, watch=lambda env, td: targets.append(td["target"].clone())
        )
        return (torch.stack(targets) - torch.tensor(ZEROTH01.stand_position)).abs().max()

    assert moved(passive(cfg)) < 1e-6
    assert moved(cfg) > 0.5
