"""Recipes from the shell: they run, write their files, and refuse bad input in one line."""

import gc
import importlib
import io
import json
import re
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from torchrl.envs import ExplorationType, set_exploration_type
from torchrl.modules.utils import get_primers_from_module

from recipes.one_line import start
from recipes.run_folder import RunFolder
from recipes.tested import POLICIES, held, keep, load_run
from recipes.train import garbage_collector_of_new_things
from zfall import checkpoint
from zfall.envs.make import left_out
from zfall.envs.robots import ZEROTH01
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.modules.actors import recurrent_keys

ROOT = Path(__file__).parents[1]
TINY = ["num_envs=8", "rollout_steps=4", "minibatches=2", "total_frames=64", "checkpoint_every=1",
        "showcase=null"]  # fmt: skip
SHOW = ["showcase={starts: 1, sizes: [0.4], video: false}"]
SMALL_SETTING = "planar_point-pelvis_directions-2_impulses-0.2_starts-1_end_time-4.0"
SMALL = ["starts=1", "directions=2", "impulses=[0.2]", "point=pelvis", "end_time=4.0"]


class Done(NamedTuple):
    """How a program ended."""

    returncode: int
    stdout: str
    stderr: str


def run(module: str, *args: str) -> Done:
    """``python -m recipes.MODULE ARGS`` in this process, which has imported everything."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    argv, sys.argv = sys.argv, [f"recipes/{module}.py", *args]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            start(importlib.import_module(f"recipes.{module}").main)
    except SystemExit as stop:
        code = stop.code
    finally:
        sys.argv = argv
    if isinstance(code, str):  # as the interpreter does: print it and exit with 1
        err.write(code + "\n")
        code = 1
    return Done(int(code or 0), out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    done = run("train", *TINY[:-1], *SHOW, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert "pose_hold" in done.stdout
    return folder


def test_runs_started_together_have_folders_of_their_own():
    """A shell starts several within one second; in one folder they would overwrite each other."""
    texts = [recipe.read_text() for recipe in (ROOT / "recipes").glob("*.yaml")]
    formats = [item for text in texts for item in re.findall(r"\$\{now:([^}]*)\}", text)]
    assert len(formats) >= 8
    one = datetime(2026, 1, 1, 12)
    for item in formats:
        assert one.strftime(item) != (one + timedelta(milliseconds=1)).strftime(item)


def test_training_leaves_the_files_of_a_run(trained):
    for name in ("metrics.csv", "timing.csv", "summary.json", ".hydra/config.yaml",
                 "checkpoints/last.pt", "checkpoints/best.pt", "plots/planar.png",
                 "plots/learning_curves.png", "tensorboard"):  # fmt: skip
        assert (trained / name).exists(), name
    metrics = pd.read_csv(trained / "metrics.csv")
    assert metrics["frames"].tolist() == [32, 64]
    expected = {"episode_return", "episode_seconds", "kl", "reward/upright", "loss/objective"}
    assert expected <= set(metrics.columns)
    assert not [column for column in metrics if "_s" in column[-3:] and column != "episode_seconds"]


def test_battery_of_a_run_and_of_a_baseline(trained, tmp_path):
    done = run("evaluate", f"run={trained}", "battery=planar", *SMALL, "num_envs=64")
    assert done.returncode == 0, done.stderr
    folder = trained / "evaluation" / SMALL_SETTING
    summary = json.loads((folder / "summary.json").read_text())
    assert {"battery_version", "n", "i50_mean", "i50_min", "i90_mean", "i50", "success", "success_low",
            "success_high", "control_falls", "control_n"} <= set(summary)  # fmt: skip
    trials = pd.read_csv(folder / "trials.csv")
    assert len(trials) == summary["n"] == 4
    assert {"direction_rad", "impulse", "duration_s", "force_n", "body", "seed", "recovered", "fell",
            "kneeled", "time_to_fall_s", "peak_base_acceleration",
            "peak_contact_force"} <= set(trials.columns)  # fmt: skip
    assert (folder / "success_map.png").exists()


@pytest.mark.parametrize("name", ["pose_hold", "limp"])
def test_battery_of_a_baseline_goes_into_hydras_folder(name, tmp_path):
    done = run("evaluate", f"run={name}", *SMALL, "num_envs=64", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "evaluation" / SMALL_SETTING / "summary.json").read_text())
    assert summary["control_falls"] == (2 if name == "limp" else 0)
    assert summary["definition"]["starts"] == 1


def test_rows_of_metrics_keep_their_columns_when_no_episode_ends(tmp_path):
    """The first batch of 4 steps ends no episode, later ones do."""
    more = ["total_frames=256", "env.transforms.limit.seconds=0.2", f"hydra.run.dir={tmp_path}"]
    done = run("train", *TINY, *more)
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "metrics.csv")
    assert metrics["episodes"].iloc[0] == 0 < metrics["episodes"].max()
    assert metrics["episode_return"].isna().iloc[0]
    ended = metrics[metrics["episodes"] > 0]
    assert (ended["episode_seconds"] - 0.2).abs().max() < 1e-6
    assert (metrics["reward/survival"] - 0.1).abs().max() < 1e-6
    assert (metrics["kl"] >= 0).all()


EVENTFUL = ["env.transforms.push.interval=[0.0,0.1]", "env.transforms.limit.seconds=0.3"]
REALISTIC = "env=push_recovery_realistic"  # all transforms at once


RECURRENT = "actor=gru_mog critic=gru loss=icub"  # state of a critic, and of a penalty


# A predictor with a memory, and a machine that counts: some worlds begin to kneel.
KNEELING = (
    "experiment=push_to_kneel env.transforms.mode.probability=0.5 env.transforms.mode.hold=0.08 "
    "env.transforms.push.size=[1.0,2.0]"
)


@pytest.mark.parametrize("part", [RECURRENT, REALISTIC, KNEELING])
def test_stopped_and_resumed_run_equals_the_one_not_stopped(part, tmp_path):
    """Same metrics, to the last digit; a row written after the checkpoint is dropped."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    common = [*TINY, *EVENTFUL, *part.split()]
    assert run("train", *common, "total_frames=128", f"hydra.run.dir={whole}").returncode == 0
    assert run("train", *common, "total_frames=64", f"hydra.run.dir={parts}").returncode == 0
    with (parts / "metrics.csv").open("a") as file:
        file.write("3,96,half a row")
    done = run("train", f"resume={parts}", "total_frames=128", f"hydra.run.dir={tmp_path}/x")
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(whole / "metrics.csv")
    assert metrics["episodes"].sum() > 0
    if part == KNEELING:
        assert metrics["reward/com_lowering"].iloc[-1] > 0
    if part == REALISTIC:  # what was drawn and how hard the task is are logged
        assert metrics["params/foot_friction"].between(0.5, 1.5).all()
        assert metrics["curriculum/level"].iloc[-1] > 0
    if part == RECURRENT:
        assert metrics["loss/kl_coeff"].iloc[-1] != metrics["loss/kl_coeff"].iloc[0]
    assert (parts / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()


@pytest.mark.parametrize("actor", ["mlp_mog", "gru_mog"])
def test_every_actor_trains(actor, tmp_path):
    done = run("train", *TINY, f"actor={actor}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr


PAPERS = ["icub_balance", "atalante_standing", "zeroth_fall"]


@pytest.mark.parametrize(
    "name", [*(name + end for name in PAPERS for end in ("", "_laptop")), "best_gru"]
)
def test_every_experiment_learns(name, tmp_path):
    """Its networks, loss and optimizer, on a small batch."""
    done = run("train", f"experiment={name}", *TINY, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "metrics.csv")
    assert metrics["frames"].tolist() == [32, 64]
    assert metrics.filter(regex="^loss/").notna().all(axis=None)


@pytest.mark.parametrize("name", PAPERS)
def test_a_laptop_gets_the_same_task(name, compose_config):
    """Of the task only the physics' time step may differ."""
    paper, laptop = (
        compose_config(f"experiment={name}{end}", "num_envs=4").env for end in ("", "_laptop")
    )
    laptop.base_env.physics_dt = paper.base_env.physics_dt
    assert laptop == paper


def test_batches_are_those_that_were_published(compose_config):
    """Steps per update, steps or sequences per minibatch."""
    sizes = {}
    for name in PAPERS:
        cfg = compose_config(f"experiment={name}")
        sizes[name] = cfg.num_envs * cfg.rollout_steps, cfg
    batch, cfg = sizes["icub_balance"]
    assert batch == pytest.approx(10_000, rel=0.01)
    assert batch / cfg.minibatches == pytest.approx(512, rel=0.03)
    batch, cfg = sizes["zeroth_fall"]
    assert cfg.num_envs / cfg.minibatches == 64
    assert cfg.rollout_steps * 0.02 == pytest.approx(2.0)  # at its 50 Hz


def row(td, next_td):
    """A reward term without its last dimension."""
    return next_td["done"][:, 0].float()


BAD = [
    (["num_envs=0"], "num_envs must be at least 1, got 0"),
    (["num_envs=-4"], "num_envs must be at least 1, got -4"),
    (["num_envs=abc"], "num_envs must be a whole number, got abc"),
    (["total_frame=3"], "Unless it is misspelt, write +total_frame=3"),
    (["loss.gamma=2"], "loss.gamma must lie in [0, 1], got 2"),
    (["loss.clip_epsilon=abc"], "loss.clip_epsilon must be positive, got abc"),
    (["optimizer=null"], "optimizer must name one"),
    (["max_grad_norm=0"], "max_grad_norm must be positive, got 0"),
    (["optimizer.lr=abc"], "optimizer.lr must not be negative, got abc"),
    (["minibatches=33"], "minibatches must not be more than the 32 samples of an update, got 33"),
    (["actor=gru_mog", "minibatches=9"], "more than the 8 sequences of an update, got 9"),
    (
        ["env.transforms.reward.terms.posture.0=x"],
        "terms.posture must have a number as its weight, got x",
    ),
    (
        ["+env.transforms.push.siez=[0.1,0.2]"],
        "env: transforms.push.siez is not a parameter of RandomPush (env, point, ",
    ),
    (
        ["warm_start=pose_hold"],
        "warm_start must be a run folder, or one of atalante, best, best_gru, kneel, zeroth_fall; there",
    ),
    (
        [
            "+env.transforms.reward.terms.mine=[0.1,{_target_:tests.test_recipes.row,_partial_:true}]"
        ],
        "terms.mine must return (2, 1), one number per world, got (2,)",
    ),
    (["total_frames=many"], "total_frames must be a positive number, got many"),
    (
        [
            "+env.transforms.reward.terms.knee="
            "[0.1,{_target_:zfall.envs.terms.posture.reference_posture,_partial_:true}]"
        ],
        "env.transforms.reward: reference_posture must be given sigma, which has no default",
    ),
    (["env.base_env.control_dt=0.03"], "control_dt must be a multiple of physics_dt"),
    (["env.transforms.delay.delay=[0,0.5]"], "env.transforms.delay: delay must be"),
    (["env.transforms.push.point=tail"], "env.transforms.push: point must be a push point"),
    (["+env.transforms.push.impulze=1"], "impulze"),
    (["numenvs=3"], "numenvs"),
    (["+epoch=3"], "epoch is not a key of the config"),
    (["actor=mlp_transformer"], "mlp_transformer"),
    (["+loss.clip_eps=0.3"], "loss.clip_eps is not a key of the config"),
    (["showcase={foo: 1}"], "showcase.foo is not a key of the config"),
    (["rollout_steps=0"], "rollout_steps must be at least 1, got 0"),
    (["showcase={starts: 0, sizes: [0.4], video: false}"], "starts must be at least 1, got 0"),
    (["loss.kl_target=0.01"], "kl_target must be positive and go with a positive kl_coeff"),
    (["actor.activation=gelu"], "activation must be one of elu, relu, tanh, got 'gelu'"),
    (["actor=mlp_mog", "+actor.learn_std=false"], "learn_std must be true with components"),
    (
        ["experiment=atalante_standing_laptop", "actor=gru_gaussian"],
        "actor: make_head() takes no num_cells; if the config gives it, '~actor.num_cells' takes",
    ),
    (["resume=nowhere"], "there is no such file"),
    (["hydra.run.dir=/proc/zfall"], "/proc/zfall"),
]


@pytest.mark.parametrize(("overrides", "message"), BAD, ids=[" ".join(o) for o, _ in BAD])
def test_bad_input_ends_before_the_first_step_with_a_clear_line(overrides, message, tmp_path):
    folder = [] if "hydra.run.dir" in overrides[0] else [f"hydra.run.dir={tmp_path}"]
    done = run("train", *TINY, *folder, *overrides)
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    lines = [
        line for line in done.stderr.splitlines() if "Warning" not in line and "warn" not in line
    ]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert not tmp_path.exists() or not any(tmp_path.iterdir())  # nothing is left behind


def test_resuming_with_another_actor_is_refused(trained, tmp_path):
    done = run("train", f"resume={trained}", "actor=mlp_mog", f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0
    assert "actor must not be given with resume" in done.stderr


def test_a_folder_that_holds_a_run_is_not_trained_into(trained):
    names = ("metrics.csv", ".hydra/config.yaml", ".hydra/overrides.yaml")
    before = [(trained / name).read_text() for name in names]
    done = run("train", *TINY, "seed=5", f"hydra.run.dir={trained}")
    assert done.returncode != 0
    assert f"hydra.run.dir must be a folder without a run, {trained} holds one" in done.stderr
    assert [(trained / name).read_text() for name in names] == before


@pytest.mark.parametrize("where", ["", "/.."])
def test_a_run_survives_being_resumed_into_its_own_folder(where, tmp_path):
    folder = tmp_path / "runs" / "one"
    assert run("train", *TINY, f"hydra.run.dir={folder}").returncode == 0
    config = (folder / ".hydra" / "config.yaml").read_text()
    more = [f"resume={folder}", "total_frames=96", f"hydra.run.dir={folder}{where}"]
    done = run("train", *more)
    assert done.returncode == 0, done.stderr
    assert (folder / ".hydra" / "config.yaml").read_text() == config
    assert pd.read_csv(folder / "metrics.csv")["frames"].tolist() == [32, 64, 96]


def test_a_run_is_not_resumed_to_end_before_its_end(trained):
    before = (trained / "metrics.csv").read_text()
    done = run("train", f"resume={trained}", "total_frames=32")
    assert done.returncode != 0
    assert "total_frames must not be less than the 64 that" in done.stderr
    assert (trained / "metrics.csv").read_text() == before


def test_resuming_leaves_other_folders_alone(trained, tmp_path):
    """Whatever hydra is told to be its folder: only one that it made, and that is empty, goes."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".hydra").mkdir()
    done = run("train", f"resume={trained}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / ".hydra").exists()


def test_a_run_of_another_version_is_not_gone_on_with(trained, tmp_path):
    content = checkpoint.load(trained / "checkpoints" / "last.pt")
    content.pop("format")
    content["run"].pop("version")
    (tmp_path / "checkpoints").mkdir()
    checkpoint.save(tmp_path / "checkpoints" / "last.pt", content)
    (tmp_path / "metrics.csv").write_text("update,falls\n1,3\n")
    done = run("train", f"resume={tmp_path}", "total_frames=96")
    assert done.returncode != 0
    assert "must be a run of version 2 to go on with it, got None" in done.stderr
    assert (tmp_path / "metrics.csv").read_text() == "update,falls\n1,3\n"


def test_the_best_checkpoint_is_the_hardest_level_then_the_highest_return(tmp_path):
    """Told updates with a return and a level, a save after each; later ones while there are few."""
    saved = []
    folder = RunFolder(tmp_path)
    folder.save = lambda learner, name: saved.append((learner, name))
    returns = [*[9.0] * 9, *[1.0] * 10, *[2.0] * 10, *[1.5] * 20]
    for number, value in enumerate(returns):
        level = 0.5 if number >= 39 else 0.0
        folder.note({"episode_return": value, "curriculum/level": level})
        folder.save_last_and_best(number)
    best = [number for number, name in saved if name == "best"]
    assert best[:10] == list(range(10))  # nine with 9 and one with 1: not to be beaten below
    assert set(best[10:]) == set(range(39, 49))  # until the level counts
    assert [name for number, name in saved if number == 5] == ["best", "last"]


def test_checkpoint_of_another_robot_is_refused(trained, tmp_path):
    content = checkpoint.load(trained / "checkpoints" / "last.pt")
    content.pop("format")
    (tmp_path / "checkpoints").mkdir()
    checkpoint.save(tmp_path / "checkpoints" / "last.pt", content | {"robot": "other"})
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert "must be of the robot zeroth01 " in done.stderr
    assert "it is of other" in done.stderr


def test_ctrl_c_ends_after_an_update_and_can_be_resumed(tmp_path):
    command = [
        sys.executable,
        "-m",
        "recipes.train",
        *TINY,
        "total_frames=320000",
        f"hydra.run.dir={tmp_path}",
    ]
    process = subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    metrics = tmp_path / "metrics.csv"
    for _ in range(600):
        if metrics.exists() and len(metrics.read_text().splitlines()) > 3:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "resume=" in out.replace("\n", "")
    state = checkpoint.load(tmp_path / "checkpoints" / "last.pt")
    assert state["updates"] == len(pd.read_csv(metrics))


def test_run_without_a_checkpoint_is_refused(tmp_path):
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert "there is no such file" in done.stderr


@pytest.mark.parametrize("name", sorted(path.stem for path in POLICIES.glob("*.pt")))
def test_a_policy_that_ships_stands_for_a_second(name):
    """In its own world without noise, pushes and delays, from its starts."""
    env_cfg, actor = load_run(OmegaConf.create({"checkpoint": "last"}), name)
    env = instantiate(env_cfg, base_env={"num_envs": 4}, training=False)
    if recurrent_keys(actor):
        env.append_transform(get_primers_from_module(actor))
    env.set_seed(0)
    steps = round(1.0 / env.base_env.control_dt)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(steps, actor, break_when_any_done=False)
    assert not rollout["next", "terminated"].any()


def test_best_gru_is_configured_as_it_was_trained(compose_config):
    content = checkpoint.load(POLICIES / "best_gru.pt")
    cfg = compose_config("experiment=best_gru", "showcase=null")
    assert OmegaConf.create(content["config"]) == cfg


def test_an_evaluation_keeps_on_what_it_is_told_to(compose_config):
    cfg = compose_config("num_envs=2").env
    assert {"noise", "delay"} <= set(left_out(cfg.training_only))
    assert {"noise", "delay"}.isdisjoint(left_out(keep(cfg, ["noise", "delay"]).training_only))
    with pytest.raises(ValueError, match=r"keep must name what evaluation leaves out .*got action"):
        keep(cfg, ["action"])


@pytest.mark.parametrize("given", [[], ["run=nowhere"]])
def test_an_evaluation_of_nothing_says_what_there_is(given):
    done = run("evaluate", *given)
    assert done.returncode == 1
    assert "run must be a run folder, or" in done.stderr
    assert "pose_hold" in done.stderr


def test_an_interrupted_battery_goes_on_and_ends_as_if_it_had_not_been(trained, monkeypatch):
    """Cut off after the first of two chunks; the rest is run, and the file is the same."""
    import recipes.evaluate as recipe

    args = [f"run={trained}", "starts=10", "directions=3", "impulses=[0.1,0.3]", "point=chest",
            "end_time=3.6", "num_envs=64"]  # fmt: skip
    setting = "planar_point-chest_directions-3_impulses-0.1,0.3_starts-10_end_time-3.6"
    folder = trained / "evaluation" / setting
    assert run("evaluate", *args).returncode == 0
    whole = (folder / "trials.csv").read_bytes()
    write = recipe.write_trials

    def cut_off(path, trials, asked):
        write(path, trials, asked)
        raise KeyboardInterrupt

    monkeypatch.setattr(recipe, "write_trials", cut_off)
    stopped = run("evaluate", *args)
    assert (stopped.returncode, stopped.stderr) == (130, "stopped\n")
    monkeypatch.setattr(recipe, "write_trials", write)
    assert len(pd.read_csv(folder / "trials.partial.csv")) == 64
    done = run("evaluate", *args)
    assert "goes on after 64 trials" in done.stdout.replace("\n", " ")
    assert (folder / "trials.csv").read_bytes() == whole
    assert not (folder / "trials.partial.csv").exists()


def test_runs_side_by_side_read_what_was_run_before(trained, tmp_path):
    more = [*SMALL, "num_envs=64", f"hydra.run.dir={tmp_path}"]
    done = run("evaluate", f"runs=[{trained},pose_hold,limp]", *more)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "comparison" / SMALL_SETTING
    table = pd.read_csv(folder / "comparison.csv").set_index("run")
    assert table.loc[str(trained), "difference"] == 0.0
    assert table.loc["limp", "success"] == 0.0
    assert table.loc["limp", "control_falls"] == 2
    assert (folder / "overlay.png").exists()
    assert (folder / "overlay.pdf").exists()
    again = run("evaluate", f"runs=[{trained},pose_hold,limp]", *more)
    assert again.stdout.count("read from") == 3
    assert pd.read_csv(folder / "comparison.csv").set_index("run").equals(table)


def test_a_trial_run_alone_is_the_same_trial(trained, tmp_path):
    assert run("evaluate", f"run={trained}", *SMALL, "num_envs=64").returncode == 0
    trials = pd.read_csv(trained / "evaluation" / SMALL_SETTING / "trials.csv")
    done = run("evaluate", f"run={trained}", *SMALL, "trial=3")
    assert done.returncode == 0, done.stderr
    for key in ("peak_tilt", "joint_torque_rms", "recovered", "displacement"):
        value = trials[key][3]
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        assert f"{key}: {shown}" in done.stdout
    folder = trained / "evaluation" / SMALL_SETTING
    traces = pd.read_csv(folder / "trial_3.csv")
    assert len(traces) == 100  # 4 s
    assert traces["target/left_knee_pitch"].iloc[0] != 0.0
    assert (folder / "trial_3_left_hip_pitch.png").exists()
    bad = run("evaluate", f"run={trained}", *SMALL, "trial=3", "joint=left_wing")
    assert "joint must be one of right_hip_yaw" in bad.stderr
    bad = run("evaluate", f"run={trained}", *SMALL, "trial=999")
    assert bad.returncode != 0
    assert "trial must be one of 0 to 3, got 999" in bad.stderr


def test_results_of_one_setting_do_not_overwrite_those_of_another(trained):
    assert run("evaluate", f"run={trained}", *SMALL).returncode == 0
    path = trained / "evaluation" / SMALL_SETTING / "trials.csv"
    before = path.read_bytes()
    for more in ("keep=[noise]", "seed=7", 'change=["transforms.action.scale=0.3"]'):
        assert run("evaluate", f"run={trained}", *SMALL, more).returncode == 0
        assert path.read_bytes() == before
    names = {path.name for path in (trained / "evaluation").glob(f"{SMALL_SETTING}_*")}
    assert {f"{SMALL_SETTING}_keep-noise", f"{SMALL_SETTING}_seed-7"} <= names
    assert any(
        "Battery " + name.replace("_", " ") in (trained / "report.html").read_text()
        for name in names
    )


def test_a_sweep_trains_each_value_in_a_folder_of_its_own(tmp_path, monkeypatch):
    """The folder of all is made before there is a config of any job."""
    monkeypatch.chdir(tmp_path)
    done = run("train", "-m", *TINY, "seed=0,1")
    assert done.returncode == 0, done.stderr
    folders = sorted((tmp_path / "runs" / "sweeps").glob("*/*/checkpoints/last.pt"))
    configs = [OmegaConf.load(path.parents[1] / ".hydra" / "config.yaml") for path in folders]
    assert [config.seed for config in configs] == [0, 1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["runs=best"], "error: runs must be a list, [best], got best."),
        (["run=best", "video=true"], "error: video needs a trial"),
        (["run=best", "checkpoint=foo"], "error: checkpoint must be last or best, got foo."),
        (["run=best", "starts=abc"], "error: starts must be a whole number, got abc."),
        (["run=best", "impulses=0.4"], "error: impulses must be a list of numbers"),
    ],
)
def test_values_that_make_no_sense_are_refused_in_one_line(given, message):
    done = run("evaluate", *given)
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_run_and_runs_exclude_each_other(trained):
    done = run("evaluate", f"run={trained}", f"runs=[{trained}]")
    assert "runs a list of them; got both" in done.stderr


def test_envelope_of_a_run_beside_the_held_pose(trained):
    more = ["battery=envelope", "point=torso", "directions=2", "impulses=[0.8]", "starts=1"]
    done = run("evaluate", f"run={trained}", *more, "num_envs=64", "resolution=0.4", "end_time=4.0")
    assert done.returncode == 0, done.stderr
    folder = (
        trained
        / "evaluation"
        / "envelope_point-torso_directions-2_impulses-0.8_starts-1_resolution-0.4_end_time-4.0"
    )
    table = pd.read_csv(folder / "envelope.csv")
    assert len(table) == 2
    assert table["largest"].isin([0.0, 0.4, 0.8]).all()
    for name in ("trials.csv", "summary.json", "envelope.png", "envelope.pdf"):
        assert (folder / name).exists(), name
    assert not (folder / "rounds").exists()
    bad = run("evaluate", f"runs=[{trained},pose_hold]", "battery=envelope")
    assert "runs needs a battery whose trials are the same" in bad.stderr


def test_an_interrupted_envelope_goes_on_after_its_last_round(trained, monkeypatch):
    import recipes.evaluate as recipe

    more = ["battery=envelope", "point=torso", "directions=2", "impulses=[0.8]", "starts=1"]
    args = [f"run={trained}", *more, "num_envs=64", "resolution=0.4", "end_time=3.6"]
    folder = (
        trained
        / "evaluation"
        / "envelope_point-torso_directions-2_impulses-0.8_starts-1_resolution-0.4_end_time-3.6"
    )
    assert run("evaluate", *args).returncode == 0
    whole = (folder / "trials.csv").read_bytes(), (folder / "envelope.csv").read_bytes()
    real, labels = recipe.run_battery, []

    def counted(*given, **known):
        labels.append(len(labels))
        if len(labels) == 3:
            raise KeyboardInterrupt
        return real(*given, **known)

    monkeypatch.setattr(recipe, "run_battery", counted)
    stopped = run("evaluate", *args)
    assert (stopped.returncode, stopped.stderr) == (130, "stopped\n")
    assert len(list((folder / "rounds").glob("*.csv"))) == 2
    assert run("evaluate", *args).returncode == 0
    assert len(labels) == 3 + 6 - 2  # two policies, a control arm and two rounds each
    assert ((folder / "trials.csv").read_bytes(), (folder / "envelope.csv").read_bytes()) == whole


@pytest.mark.parametrize(
    ("battery", "files"),
    [
        (["battery=spherical", "point=[torso,pelvis]", "impulses=[0.1]", "duration=[0.1,0.2]", "starts=1",
          "end_time=3.0"], ["withstood.png", "withstood.pdf", "withstood.md"]),
        (["battery=kneel", "impulses=[1.0]", "directions=2", "starts=1", "force_starts=1",
          "end_time=1.5"], ["outcomes.md", "outcomes.csv"]),
    ],
)  # fmt: skip
def test_other_batteries_write_their_files(trained, battery, files):
    done = run("evaluate", f"run={trained}", *battery, "num_envs=64")
    assert done.returncode == 0, done.stderr
    (folder,) = (trained / "evaluation").glob(f"{battery[0].removeprefix('battery=')}_*")
    for name in ["trials.csv", "summary.json", *files]:
        assert (folder / name).exists(), name
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["control_falls"] == 0
    page = (trained / "report.html").read_text()
    assert f"Battery {folder.name.replace('_', ' ')}" in page


def test_values_of_the_env_can_be_changed_and_must_be_there(trained):
    done = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.scale=0.3"]')
    assert done.returncode == 0, done.stderr
    bad = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.skale=0.3"]')
    assert "change must name a value of the env, there is no transforms.action.skale" in bad.stderr


def test_two_policies_are_switched_by_the_mode(tmp_path):
    common = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    for name in ("recover", "kneel"):
        done = run(
            "train", f"experiment=push_to_kneel_{name}", *common, f"hydra.run.dir={tmp_path}/{name}"
        )
        assert done.returncode == 0, done.stderr
    both = [f"recover={tmp_path}/recover", f"kneel={tmp_path}/kneel"]
    change = 'change=["transforms.mode.probability=0.9"]'
    done = run("switch", *both, change, f"hydra.run.dir={tmp_path}/both")
    assert done.returncode == 0, done.stderr
    config = checkpoint.load(tmp_path / "both" / "checkpoints" / "last.pt")["config"]
    assert OmegaConf.create(config).env.transforms.mode.probability == 0.9
    kneel = ["battery=kneel", "impulses=[1.0]", "directions=2", "starts=1", "force_starts=1"]
    done = run(
        "evaluate",
        f"run={tmp_path}/both",
        *kneel,
        "end_time=1.5",
        'change=["transforms.mode.angle=0.3"]',
    )
    assert done.returncode == 0, done.stderr
    done = run("switch", both[0], "kneel=script", f"hydra.run.dir={tmp_path}/script")
    assert done.returncode == 0, done.stderr
    config = checkpoint.load(tmp_path / "script" / "checkpoints" / "last.pt")["config"]
    assert OmegaConf.create(config).env.transforms.mode.hold == 0.2  # not the 100 s of its phase A
    done = run("evaluate", f"run={tmp_path}/script", *kneel, "end_time=1.5")
    assert done.returncode == 0, done.stderr
    keys = "env.transforms.observation.keys=[projected_gravity,joint_position,joint_velocity]"
    own = [keys, *common, f"hydra.run.dir={tmp_path}/other"]
    other = run("train", "experiment=push_to_kneel_kneel", *own)
    assert other.returncode == 0, other.stderr
    bad = run("switch", both[0], f"kneel={tmp_path}/other", f"hydra.run.dir={tmp_path}/bad")
    assert "must have the same env.transforms.observation" in bad.stderr
    bad = run("switch", "recover=best", "kneel=best", f"hydra.run.dir={tmp_path}/bad")
    assert "kneel must be a policy that kneels, trained with modes; best is not" in bad.stderr


def test_a_scripted_kneel_needs_modes(tmp_path):
    kneel = ["battery=kneel", "impulses=[1.0]", "directions=1", "starts=1", "force_starts=1"]
    own = [*kneel, f"hydra.run.dir={tmp_path}"]
    done = run("evaluate", "run=scripted_kneel", *own, "end_time=1.5")
    assert done.returncode == 0, done.stderr
    setting = "kneel_directions-1_impulses-1.0_starts-1_force_starts-1_end_time-1.5"
    path = tmp_path / "evaluation" / setting / "trials.csv"
    script = pd.read_csv(path)
    held = run("evaluate", "run=pose_hold", *own, "end_time=1.5")
    assert held.returncode == 0, held.stderr
    assert not pd.read_csv(path).equals(script)  # keeps to the stand
    null = 'change=["transforms.kneel_reference=null"]'
    assert run("evaluate", "run=scripted_kneel", *own, null).returncode != 0
    bad = run("evaluate", "run=scripted_kneel", *own, "env=push_recovery")
    assert "scripted_kneel needs an env with modes" in bad.stderr


def test_the_garbage_collector_spares_what_was_there_and_takes_it_back():
    def fail_amid_it():
        with garbage_collector_of_new_things():
            spared.append(gc.get_freeze_count())
            raise InterruptedError

    spared: list[int] = []
    with pytest.raises(InterruptedError):
        fail_amid_it()
    assert spared[0] > 10_000  # all of torch, for one
    assert gc.get_freeze_count() == 0


def test_baselines_beside_a_policy_meet_its_world(tmp_path):
    tiny = [*TINY, "env.base_env.physics_dt=0.008"]
    assert run("train", *tiny, f"hydra.run.dir={tmp_path}/one").returncode == 0
    runs = [f"runs=[{tmp_path}/one,pose_hold]", f"hydra.run.dir={tmp_path}/both"]
    done = run("evaluate", *runs, "battery=planar", *SMALL, "num_envs=64")
    assert done.returncode == 0, done.stderr
    (asked,) = (tmp_path / "both" / "pose_hold").glob("evaluation/*/trials.json")
    assert OmegaConf.create(json.loads(asked.read_text())["env"]).base_env.physics_dt == 0.008


def test_a_baseline_in_an_env_with_modes_holds_its_pose(compose_config):
    """Without an action its reference would go down as soon as the machine says KNEEL."""
    cfg = compose_config("env=push_to_kneel", "num_envs=2").env
    battery = load_battery("planar", impulses=[1.0], starts=1, directions=2, end_time=1.0)
    battery = replace(battery, push_time=0.2)

    def moved(world):
        targets = []
        run_battery(
            battery, world, None, watch=lambda env, td: targets.append(td["target"].clone())
        )
        return (torch.stack(targets) - torch.tensor(ZEROTH01.stand_position)).abs().max()

    assert moved(held(cfg)) < 1e-6
    assert moved(cfg) > 0.5
