"""One trial again, of several policies."""

import math

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console

from recipes import trial
from zfall.evaluation.candidate import Tested as Subject
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


def test_a_trial_is_told_in_one_line():
    row = {"impulse": 0.4, "force_n": 19.66, "duration_s": 0.1, "direction_rad": math.pi / 3}
    row |= {"body": "torso", "recovered": False, "kneeled": True, "fell": True}
    push = "I = 0.40, 19.7 N for 0.1 s toward 60 degrees (0 forward, 90 left) at torso"
    assert trial.told(row) == f"{push}, kneeled"
    assert trial.told(row | {"kneeled": False}) == f"{push}, fell"
    assert trial.told(row | {"recovered": True}) == f"{push}, recovered"
    row |= {"kneeled": False, "fell": False}
    assert trial.told(row) == f"{push}, stands bent"
    assert trial.told(row | {"direction_rad": math.nan}).startswith("I = 0.40, 19.7 N for 0.1 s at")
    assert trial.told(row | {"impulse": 0.0}) == "not pushed, stands bent"
