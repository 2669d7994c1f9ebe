"""The trigger from the shell, and the trials that it learns from."""

import numpy as np
import pandas as pd
import pytest
import torch
from hydra import compose, initialize_config_module

from recipes.falling.trigger import record, without_trigger
from tests.shell import run
from zfall.envs.tables import keep
from zfall.evaluation.battery import run_battery
from zfall.evaluation.candidate import load_run
from zfall.evaluation.definitions import load_battery


def config(run: str, *overrides: str):
    with initialize_config_module("recipes", version_base=None):
        return compose("trigger", overrides=[f"run={run}", "starts=1", *overrides])


@pytest.mark.parametrize("name", ["atalante"])  # noise, and no delay
def test_a_trigger_is_trained_on_what_there_is_of_noise_and_delay(name, tmp_path):
    few = ["starts=1", "impulses=[0.2,1.5]", "epochs=1"]
    done = run("trigger", f"run={name}", *few, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fall_network.pt").exists()
    assert {"network", "rule"} == set(pd.read_csv(tmp_path / "trigger.csv")["trigger"])


def test_what_is_recorded_is_what_happened():
    """Pushes begin in the control step up to 0.52 s, a tenth of them at its end.

    Who falls after one of these lives until the battery, with the same pushes, sees the touch.
    """
    cfg = config("best", "impulses=[1.5]")
    env_cfg, actor = load_run(cfg, "best")
    history, control_dt = record(env_cfg, actor, cfg)
    assert control_dt == 0.04
    steps = history.live.shape[1]
    assert steps == round(3.0 / 0.04)
    after = history.pushed.sum(1).numpy()  # steps that end after the begin
    assert set(after) == {62, 63}  # (3 - 0.52) / 0.04, and one in which it begins
    late = after == 62
    assert late[24:].sum() >= 2
    options = {"impulses": [1.5], "starts": 1, "directions": 24, "push_time": 0.52, "end_time": 3.0}
    trials = run_battery(load_battery("planar", **options), env_cfg, actor)
    assert history.fell.tolist() == trials["fell"].tolist()
    assert int(history.fell.sum()) == 24  # the control arm stands
    touch = 0.52 + trials["time_to_fall_s"].to_numpy()[24:]
    lived = history.live[24:].sum(1).numpy()  # steps before the one that ends with the touch
    assert np.abs(control_dt * (lived + 1) - touch)[late[24:]].max() < 1e-4
    assert np.abs(control_dt * (lived + 1) - touch).max() < 0.13
    noisy, _ = record(keep(env_cfg, ["noise"]), actor, cfg)
    spread = (noisy.measured - history.measured)[:, :1, :3].std()  # of gravity, in the first step
    assert spread == pytest.approx(0.01, rel=0.3)  # as the task says


def test_a_policy_with_modes_is_recorded_while_it_recovers():
    """Its own rule gives up after pushes that it withstands, which is no fall to learn from."""
    cfg = config("kneel", "impulses=[0.2]")
    cfg.change = ["transforms.mode.probability=null", "transforms.mode.angular_velocity=0.5"]
    env_cfg, actor = load_run(cfg, "kneel")
    gives_up, _ = record(env_cfg, actor, cfg)
    recovers, _ = record(without_trigger(env_cfg), actor, cfg)
    assert gives_up.fell.sum() > 12
    assert recovers.fell.sum() == 0
    plain = config("best", "impulses=[0.2]")
    alone, _ = record(*load_run(plain, "best"), plain)
    torch.testing.assert_close(recovers.lean, alone.lean, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("epochs=0", "epochs must be at least 1, got 0"),
        ("hidden_size=a", "hidden_size must be a whole number, got a"),
        ("starts=0", "starts must be at least 1, got 0"),
        ("impulses=[0.1]", "impulses and starts must give trials that fall and that do not"),
        ("measured=[joint_angle]", "measured must name keys of the env, got joint_angle"),
    ],
)
def test_what_no_network_can_learn_from_is_refused(given, message, tmp_path):
    done = run("trigger", "run=best", "starts=1", given, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 1
    assert f"error: {message}" in done.stderr
    assert not (tmp_path / "out").exists()
