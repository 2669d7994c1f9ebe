"""One trial again, of several policies."""

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from recipes import trial
from recipes.tested import Tested as Subject
from zfall.evaluation.definitions import load_battery


def test_runs_whose_folders_have_the_same_name_are_drawn_apart(tmp_path, monkeypatch):
    drawn = []
    rows = pd.DataFrame(
        {f"{key}/left_hip_pitch": [0.0] for key in ("target", "position", "torque")}
    )
    monkeypatch.setattr(
        trial, "run_trial", lambda *_: ({"impulse": 0.5, "duration_s": 0.1}, rows, [])
    )
    monkeypatch.setattr(trial, "trace_plot", lambda traces, *_, **__: drawn.append(list(traces)))
    tested = [
        Subject(name, None, None, tmp_path, "") for name in ("runs/A/0", "runs/B/0", "pose_hold")
    ]
    cfg = OmegaConf.create({"trial": 3, "joint": "left_hip_pitch"})
    trial.show_trial(load_battery("planar"), tested, cfg, Console(quiet=True), tmp_path)
    assert drawn == [["runs/A/0", "runs/B/0", "pose_hold"]] * 2
