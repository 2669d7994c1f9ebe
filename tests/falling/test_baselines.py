"""Baselines that kneel by script."""

import pandas as pd
import pytest
import torch
from hydra.utils import instantiate
from tensordict import TensorDict
from torch.testing import assert_close

from tests.shell import run
from zfall.evaluation.baselines import load_baseline
from zfall.falling.kneel_reference import KneelReference
from zfall.robots import ZEROTH01


@pytest.mark.long
def test_a_scripted_kneel_is_another_way_down_and_needs_modes(tmp_path):
    kneel = ["battery=kneel", "impulses=[1.0]", "directions=1", "starts=1", "force_starts=1"]
    own = [*kneel, f"hydra.run.dir={tmp_path}"]
    done = run("evaluate", "run=scripted_kneel", *own, "end_time=1.5")
    assert done.returncode == 0, done.stderr
    setting = "kneel_directions-1_impulses-1.0_starts-1_force_starts-1_end_time-1.5"
    path = tmp_path / "evaluation" / setting / "trials.csv"
    script = pd.read_csv(path)
    still = run("evaluate", "run=pose_hold", *own, "end_time=1.5")
    assert still.returncode == 0, still.stderr
    assert not pd.read_csv(path).equals(script)  # keeps to the stand
    catch = run("evaluate", "run=scripted_catch", *own, "end_time=1.5")
    assert catch.returncode == 0, catch.stderr
    assert not pd.read_csv(path).equals(script)  # other postures
    null = 'change=["transforms.kneel_reference=null"]'
    assert run("evaluate", "run=scripted_kneel", *own, null).returncode != 0
    bad = run("evaluate", "run=scripted_kneel", *own, "env=push_recovery")
    assert "env must have modes" in bad.stderr


def test_a_scripted_kneel_goes_to_the_kneel_however_fast_the_fall(compose_config):
    """In mode KNEEL, moving at 2 m/s; ``scripted_catch`` goes somewhere else."""
    cfg = compose_config("env=push_to_kneel", "num_envs=1").env
    reached = {}
    for name in ("scripted_kneel", "scripted_catch"):
        env = instantiate(load_baseline(name).world(cfg))
        reference = next(t for t in env.transform if isinstance(t, KneelReference))
        for _ in range(20):
            td = TensorDict(
                {
                    "mode": torch.tensor([[0.0, 1.0, 0.0]]),
                    "base_orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
                    "com_velocity": torch.tensor([[2.0, 0.0, 0.0]]),
                    "target": reference.stand[None],
                },
                [1],
            )
            reached[name] = reference.inv(td)["target"][0]
    kneel = torch.tensor(ZEROTH01.posture("kneel"))
    assert_close(reached["scripted_kneel"], kneel.clamp(*reference.range.unbind(-1)))
    assert (reached["scripted_catch"] - kneel).abs().max() > 0.3
