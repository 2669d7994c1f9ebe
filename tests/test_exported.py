"""What is exported meets the same pushes in dm_control as the policy does in zfall."""

import pandas as pd
import pytest
from omegaconf import OmegaConf

from recipes.export import export
from recipes.exported import OnnxPolicy, agreement, run_exported
from recipes.tested import load_run
from tests.test_recipes import run
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery

BATTERY = load_battery("planar", starts=1, impulses=[0.3, 1.9])
TRIALS = [0, 12, 24, 30]  # no push; a small one forward; large ones forward and backward
LATEST = OmegaConf.create({"checkpoint": "last", "env": None, "change": []})


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    pytest.importorskip("onnxruntime")
    folder = tmp_path_factory.mktemp("exported")
    env_cfg, actor = load_run(LATEST, "best")
    export(actor, folder / "policy.onnx", size=actor[0].module[0].mean.shape[-1])
    exported = run_exported(BATTERY, env_cfg, OnnxPolicy(folder / "policy.onnx", None), only=TRIALS)
    return exported, run_battery(BATTERY, env_cfg, actor, only=TRIALS)


def test_trials_end_as_those_of_the_policy(both):
    exported, own = both
    assert exported["recovered"].tolist() == own["recovered"].tolist() == [True, True, False, False]
    falls = ~own["recovered"]
    # Rounding in the network moves a fall by a control step at most.
    assert exported["time_to_fall_s"][falls].tolist() == pytest.approx(
        own["time_to_fall_s"][falls].tolist(), abs=0.041
    )
    assert exported["impulse"].tolist() == [0.0, 0.3, 1.9, 1.9]


def test_agreement_counts_by_hand():
    """Two trials of each of two directions at one size; one ends otherwise."""
    base = pd.DataFrame(
        {
            "direction_rad": [0.0, 0.0, 1.0, 1.0],
            "impulse": 0.5,
            "force_n": 1.0,
            "seed": 0,
            "fell": False,
            "target_smoothness": 0.0,
        }
    )
    text = agreement(
        BATTERY,
        base.assign(recovered=[True, True, True, False]),
        base.assign(recovered=[True, True, False, False]),
    )
    assert "3 of 4 trials end alike" in text
    assert "dm_control: recovered 0.750, I50 mean 0.500, least 0.50" in text
    assert "zfall: recovered 0.500, I50 mean 0.250, least 0.00" in text
    assert "McNemar): 1.00" in text  # one trial of one: as likely either way


def test_planar_of_no_start_is_refused(tmp_path):
    done = run("export", "run=best", "planar=0", f"hydra.run.dir={tmp_path}")
    assert "planar must be at least one start per cell, got 0" in done.stderr
