"""What is exported meets the same pushes in dm_control as the policy does in zfall."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf
from torchrl.data import Composite, Unbounded

from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.exported import OnnxPolicy, agreement, run_exported
from zfall.modules.actors import gru_actor
from zfall.policies.export import describe, export
from zfall.policies.load import load_policy

BATTERY = load_battery("planar", starts=1, impulses=[0.3, 1.9])
TRIALS = [0, 12, 24, 30]  # no push; a small one forward; large ones forward and backward


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The policy that ships: config, actor, and what was exported of it."""
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("exported") / "policy.onnx"
    policy = load_policy("best")
    env_cfg, actor = policy.config.env, policy.actor
    about = describe(battery_env(BATTERY, env_cfg, 1)[0], actor, env_cfg)
    export(actor, path, size=about["observation_size"])
    return env_cfg, actor, OnnxPolicy(path, json.loads(json.dumps(about)))


def test_trials_end_as_those_of_the_policy(exported):
    env_cfg, actor, policy = exported
    theirs = run_exported(BATTERY, env_cfg, policy, only=TRIALS)
    ours = run_battery(BATTERY, env_cfg, actor, only=TRIALS)
    assert theirs["recovered"].tolist() == ours["recovered"].tolist() == [True, True, False, False]
    falls = ~ours["recovered"]
    # Rounding in the network moves a fall by a control step at most.
    for column, error in (("time_to_fall_s", 0.041), ("impact_energy", 1.0)):
        assert theirs[column][falls].tolist() == pytest.approx(
            ours[column][falls].tolist(), abs=error
        )
    assert theirs["impulse"].tolist() == [0.0, 0.3, 1.9, 1.9]
    assert set(theirs) - set(ours) == {"target_error"}
    assert theirs["target_error"].max() < 1e-6


def test_a_description_that_is_wrong_is_seen(exported):
    """Twice the scale: half of each action is missing in the targets."""
    env_cfg, _, policy = exported
    wrong = OnnxPolicy.__new__(OnnxPolicy)
    wrong.session, wrong.about = policy.session, policy.about | {"scale_rad": 1.2}
    table = run_exported(replace(BATTERY, end_time=0.4), env_cfg, wrong, only=[0])
    assert table["target_error"].item() > 0.1


@pytest.mark.parametrize(
    ("change", "only", "message"),
    [
        ({}, [999], "trial must be one of 0 to 35, got 999"),
        ({"limit": {"seconds": 0.2}}, [0], "episodes must last 7.0 s, one ended before"),
    ],
)
def test_what_cannot_be_run_is_refused(exported, change, only, message):
    env_cfg, _, policy = exported
    changed = OmegaConf.merge(env_cfg, {"transforms": change})
    with pytest.raises(ValueError, match=message):
        run_exported(BATTERY, changed, policy, only=only)


def test_agreement_counts_by_hand():
    """Two trials of each of two directions at one size, and one without a push."""
    base = pd.DataFrame(
        {
            "direction_rad": [0.0, 0.0, 0.0, 1.0, 1.0],
            "impulse": [0.0, 0.5, 0.5, 0.5, 0.5],
            "force_n": 1.0,
            "seed": 0,
            "fell": [True, False, False, False, False],
            "target_smoothness": 0.0,
            "target_error": [0.0, 0.0, 2e-7, 0.0, 0.0],
        }
    )
    text = agreement(
        BATTERY,
        base.assign(recovered=[False, True, True, True, False]),
        base.assign(recovered=[True, True, False, False, True]),
    )
    assert (
        "1 of 4 pushed trials end the same way, 2 are recovered from only as exported, 1 only"
        in text
    )
    assert "as exported: recovered 0.750, I50 mean 0.500, least 0.50, falls without" in text
    assert "in zfall: recovered 0.500, I50 mean 0.500, least 0.50" in text
    assert "a push 1 of 1" in text
    assert "to 2e-07 rad" in text


def test_a_memory_is_kept_between_steps_and_lost_at_a_reset(tmp_path):
    """The same observation twice: the second action knows of the first, after a reset none does."""
    pytest.importorskip("onnxruntime")
    torch.manual_seed(0)
    spec = Composite(observation=Unbounded((1, 12)), shape=(1,))
    actor = gru_actor(spec, Unbounded((1, 5)), hidden_size=8, num_layers=2)
    for parameter in actor.parameters():  # else all actions are zero
        parameter.data += 0.3 * torch.randn_like(parameter)
    export(actor, tmp_path / "policy.onnx", size=12)
    policy = OnnxPolicy(tmp_path / "policy.onnx", {"memories": {"memory": [1, 2, 8]}})
    seen = np.ones(12, dtype=np.float32)
    first, second = policy(seen), policy(seen)
    policy.reset()
    assert np.abs(second - first).max() > 1e-3
    assert policy(seen).tolist() == first.tolist()
