"""One trial again, of several policies."""

import math

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from zfall.evaluation import single_trial
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.followers import outcome_names
from zfall.evaluation.single_trial import Replay, run_trial, sentence, show_trial


def test_runs_whose_folders_have_the_same_name_are_drawn_apart(tmp_path, monkeypatch):
    drawn = []
    rows = pd.DataFrame(
        {f"{key}/left_hip_pitch": [0.0] for key in ("target", "position", "torque")}
    )
    row = {
        "impulse": 0.5,
        "force_n": 25.0,
        "duration_s": 0.1,
        "direction_rad": 0.0,
        "body": "torso",
    }
    replay = Replay(row, rows, [(3.0, 3.1)], np.zeros(0), np.zeros(0), None)
    monkeypatch.setattr(single_trial, "run_trial", lambda *_, **__: replay)
    monkeypatch.setattr(
        single_trial,
        "trace_plot",
        lambda traces, *_, pushes, **__: drawn.append((list(traces), pushes)),
    )
    names = ["runs/A/0", "runs/B/0", "pose_hold"]
    candidates = [Candidate(name, None, None) for name in names]
    folders = {name: tmp_path / name for name in names}
    given = {"seed": 0, "joint": "left_hip_pitch", "video": False}
    console = Console(quiet=True)
    show_trial(load_battery("planar"), 3, candidates, folders, tmp_path, console, **given)
    assert drawn == [(names, [(3.0, 3.1)])] * 2
    assert all((folder / "trial_3.csv").exists() for folder in folders.values())


def test_pushes_of_a_trial_are_those_of_its_plan(compose_config):
    """The one at 3 s of a planar battery, none of its control arm; several of a spherical one."""
    candidate = Candidate("pose_hold", compose_config("num_envs=1").env, None)
    given = {"seed": 0, "joint": "left_hip_pitch"}
    planar = load_battery("planar", starts=1, impulses=[0.1], directions=1, end_time=3.3)
    assert run_trial(planar, candidate, 1, **given).pushes == [(3.0, pytest.approx(3.1))]
    assert run_trial(planar, candidate, 0, **given).pushes == []
    few = {"starts": 1, "impulses": [0.02], "point": "torso", "duration": 0.1}
    spherical = load_battery("spherical", **few, interval=0.4, end_time=3.0)
    replay = run_trial(spherical, candidate, 1, **given)
    assert len(replay.pushes) == replay.row["withstood"] > 1
    assert all(1.0 <= begin < end for begin, end in replay.pushes)


def test_a_trial_is_said_in_one_line():
    row = {"impulse": 0.4, "force_n": 19.66, "duration_s": 0.1, "direction_rad": math.pi / 3}
    row |= {"body": "torso", "recovered": False, "kneeled": True, "fell": True}
    push = "I = 0.40, 19.7 N for 0.1 s toward 60 degrees (0 forward, 90 left) at torso"
    outcomes = outcome_names(load_battery("kneel"))
    assert sentence(row, outcomes) == f"{push}, kneeled"
    assert sentence(row | {"kneeled": False}, outcomes) == f"{push}, fell"
    assert sentence(row | {"recovered": True}, outcomes) == f"{push}, recovered"
    row |= {"kneeled": False, "fell": False}
    assert sentence(row, outcomes) == f"{push}, stands bent"
    level = sentence(row | {"direction_rad": math.nan}, outcomes)
    assert level.startswith("I = 0.40, 19.7 N for 0.1 s at")
    assert sentence(row | {"impulse": 0.0}, outcomes) == "not pushed, stands bent"
