"""Real training: minutes each, run with ``make slow-test``."""

import pandas as pd
import pytest
import torch

from zfall.cores import usable_cores
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.training.learner import Learner

# What each takes to get there, with some room: mixtures are slower, recurrent ones the slowest.
FRAMES = {"mlp_gaussian": 1_200_000, "mlp_mog": 1_600_000, "gru_mog": 3_000_000}


def success(trials: pd.DataFrame) -> float:
    return trials[trials["impulse"] == 0.4]["recovered"].mean()


@pytest.mark.slow
@pytest.mark.parametrize("actor", FRAMES)
def test_policy_learns_to_withstand_pushes_that_fell_the_held_pose(compose_config, actor):
    """Success at I = 0.4 over 12 directions x 5 starts, against servos that hold the pose."""
    torch.set_num_threads(usable_cores())  # all cores, as in a run
    cfg = compose_config(f"actor={actor}")
    battery = load_battery("planar", impulses=[0.4], starts=5)
    baseline = success(run_battery(battery, cfg.env, None))
    learner = Learner(cfg)
    while learner.frames < FRAMES[actor]:
        learner.learn(learner.collect())
    trials = run_battery(battery, cfg.env, learner.policy)
    print(f"{actor}: {success(trials):.3f} after {learner.frames} frames, pose_hold {baseline:.3f}")
    assert success(trials) > baseline + 0.1
    assert not trials[trials["impulse"] == 0.0]["fell"].any()
