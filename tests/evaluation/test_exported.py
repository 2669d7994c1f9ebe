"""What is exported meets the same pushes in dm_control as the policy does in zfall."""

import json
from dataclasses import replace

import pandas as pd
import pytest
from omegaconf import OmegaConf

from zfall.evaluation.battery import battery_env, run_battery
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.exported import agreement, run_exported
from zfall.policies.export import describe, export_policy
from zfall.policies.exported import ExportedPolicy
from zfall.policies.load import load_policy

BATTERY = load_battery("planar", starts=1, impulses=[0.3, 1.9])
TRIALS = [0, 12, 24, 30]  # no push; a small one forward; large ones forward and backward


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The policy that ships: config, actor, and what was exported of it."""
    pytest.importorskip("onnxruntime")
    folder = tmp_path_factory.mktemp("exported")
    policy = load_policy("best")
    env_cfg, actor = policy.config.env, policy.actor
    env, _, _ = battery_env(BATTERY, env_cfg, 1)
    about = describe(env, export_policy(env, actor, folder / "policy.onnx"), env_cfg)
    (folder / "policy.json").write_text(json.dumps(about))
    return env_cfg, actor, ExportedPolicy(folder)


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


def test_a_task_with_other_targets_is_seen(exported):
    """Twice the scale in the task: half of each action is missing in the exported targets."""
    env_cfg, _, policy = exported
    wrong = OmegaConf.merge(env_cfg, {"transforms": {"action": {"scale": 1.2}}})
    table = run_exported(replace(BATTERY, end_time=0.4), wrong, policy, only=[0])
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
