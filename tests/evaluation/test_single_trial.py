"""One trial again, of several policies."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from zfall.evaluation import single_trial
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.followers import outcome_names
from zfall.evaluation.single_trial import Replay, run_trial, sentence, show_trial
from zfall.evaluation.video import Cut


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
    replay = Replay(row, rows, [(3.0, 3.1)], np.zeros(0), np.zeros(0), None, 5.0, {})
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


def test_a_film_of_a_trial_names_it_and_goes_as_slow_as_asked(tmp_path, monkeypatch):
    """A fall 0.2 s after the push of 0.5 s is called one from 0.7 s on, what led to it before."""
    filmed = []
    monkeypatch.setattr(
        single_trial, "film", lambda model, rows, columns, *_, **kw: filmed.append((columns, kw))
    )
    row = {"trial": 7, "impulse": 0.5, "force_n": 25.0, "duration_s": 0.1, "direction_rad": 0.0}
    row |= {"body": "torso", "fell": True, "time_to_fall_s": 0.2}
    seconds = pd.DataFrame(
        {"time_s": [0.04], **{f"{k}/left_hip_pitch": 0.0 for k in ("target", "position", "torque")}}
    )
    env = SimpleNamespace(control_dt=0.04, camera=SimpleNamespace(model=None))
    log = SimpleNamespace(frames=lambda ends: None)
    replay = Replay(
        row, seconds, [(0.5, 0.6)], np.zeros((1, 1, 7)), log, env, 5.0, {"gives up": 0.6}
    )
    monkeypatch.setattr(single_trial, "run_trial", lambda *_, **__: replay)
    given = {"seed": 0, "joint": "left_hip_pitch", "video": True, "cut": Cut(0.25)}
    candidates = [Candidate("mine", OmegaConf.create({"base_env": {}}), None)]
    console = Console(quiet=True)
    where = {"mine": tmp_path}
    show_trial(load_battery("kneel"), 7, candidates, where, tmp_path, console, **given)
    ((columns, settings),) = filmed
    assert columns == ["trial 7 of kneel; published servos, nominal world"]
    assert settings["cut"].slow == 0.25
    (said,) = settings["outcomes"]["mine"]
    assert said == [(0.6, "gives up {when}", None), (pytest.approx(0.7), "fell {when}", False)]
    # Falls count from when the battery pushes, 3 s in planar, also of trials without a push.
    monkeypatch.setattr(single_trial, "run_trial", lambda *_, **__: replace(replay, pushes=[]))
    show_trial(load_battery("planar"), 7, candidates, where, tmp_path, console, **given)
    (said,) = filmed[1][1]["outcomes"]["mine"]
    assert said[1] == (pytest.approx(3.2), "fell {when}", False)


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
