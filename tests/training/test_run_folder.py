"""What a run writes down."""

import errno
import os
import shutil
import subprocess
import sys
import threading
import time

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf
from rich.console import Console

from tests.shell import ROOT, TINY, run
from zfall import checkpoint
from zfall.training import run_folder
from zfall.training.learner import Learner
from zfall.training.logging import quiet_threads
from zfall.training.loop import run_training, train
from zfall.training.rows import append_row, keep_rows
from zfall.training.run_folder import LOCK, RunFolder


def test_rows_of_metrics_keep_their_columns_when_no_episode_ends(tmp_path):
    """The first batch of 4 steps ends no episode, later ones do."""
    more = [
        "total_frames=256",
        "statistics_batches=0",
        "env.transforms.limit.seconds=0.2",
        f"hydra.run.dir={tmp_path}",
    ]
    done = run("train", *TINY, *more)
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "metrics.csv")
    assert metrics["episodes"].iloc[0] == 0 < metrics["episodes"].max()
    assert metrics["episode_return"].isna().iloc[0]
    ended = metrics[metrics["episodes"] > 0]
    assert (ended["episode_seconds"] - 0.2).abs().max() < 1e-6
    assert (metrics["reward/survival"] - 0.1).abs().max() < 1e-6
    assert (metrics["kl"] >= 0).all()


@pytest.mark.parametrize(
    "recipe", ["evaluate", "play", "export", "falling.trigger", "falling.falls"]
)
def test_a_recipe_that_is_refused_leaves_no_folder(recipe, tmp_path):
    done = run(recipe, "run=nowhere", f"hydra.run.dir={tmp_path}/new")
    assert done.returncode == 1
    assert "there is no folder nowhere" in done.stderr
    assert not (tmp_path / "new").exists()


def test_the_best_checkpoint_is_the_hardest_level_then_the_highest_return(tmp_path):
    """Told updates with a return and a level, a save after each; later ones while there are few."""
    saved = []
    folder = RunFolder(tmp_path, OmegaConf.create({"logger": []}))
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


def test_a_refused_logger_leaves_nothing_that_looks_like_a_run(tmp_path):
    logger = {"_target_": "torchrl.record.CSVLogger", "exp_name": "{nme}"}
    with pytest.raises(ValueError, match=r"logger.0.exp_name .*got \{nme\}"):
        RunFolder(tmp_path / "run", OmegaConf.create({"logger": [logger]}))
    assert not (tmp_path / "run" / "checkpoints").exists()


ROWS = ["update,frames,kl", "1,32,0.5", "2,64,0.25", "3,96,"]


def test_many_rows_are_kept_in_a_time_that_grows_with_their_number(tmp_path):
    """Looking through all rows at each of 60 000 would take half a minute."""
    path = tmp_path / "metrics.csv"
    rows = [f"{number},{32 * number},0.5" for number in range(1, 60_001)]
    path.write_text("\n".join(["update,frames,kl", *rows, ""]))
    begin = time.process_time()
    assert keep_rows(path, (), 60_000) == 0
    assert time.process_time() - begin < 3.0


DAMAGES = {  # what a file may look like, and which updates are lost of the first three
    "whole": ("\n".join([*ROWS, "4,128,1.0", "5,1"]), 0),
    "cut in a row": ("\n".join(ROWS[:3])[:-3], 2),
    "an empty file": ("", 3),
    "garbage": ("\x00\x01\xff garbage, \n\n,,\n", 3),
    "a row that is garbage": ("\n".join([*ROWS[:2], "2,64,0.2\x005", ROWS[3], ""]), 1),
    "a row too short": ("\n".join([*ROWS[:2], "2,64", ROWS[3], ""]), 1),
    "no header": ("\n".join([*ROWS[1:], ""]), 0),
    "rows twice": ("\n".join([*ROWS, *ROWS[1:], ""]), 0),
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_of_a_damaged_file_the_sound_rows_up_to_the_checkpoint_are_kept(kind, tmp_path):
    content, lost = DAMAGES[kind]
    path = tmp_path / "metrics.csv"
    path.write_bytes(content.encode("latin-1"))
    assert keep_rows(path, ["update", "frames", "kl"], 3) == lost
    if lost < 3:
        lines = path.read_text().splitlines()
        assert lines[0] == ROWS[0]
        assert lines[1:] == [row for row in ROWS[1:] if row in lines]
        assert len(lines) == 4 - lost
    append_row(path, {"update": 4, "frames": 128, "kl": 0.125})
    assert pd.read_csv(path)["update"].tolist()[-1] == 4
    assert [entry.name for entry in tmp_path.iterdir()] == ["metrics.csv"]


def test_a_column_that_is_new_is_empty_in_the_rows_before(tmp_path):
    path = tmp_path / "metrics.csv"
    append_row(path, {"update": 1, "old": 0.1})
    assert append_row(path, {"update": 2, "new": 0.2}) == ["update", "new", "old"]
    assert path.read_text() == "update,new,old\n1,,0.1\n2,0.2,\n"


@pytest.mark.parametrize("damage", ["deleted", "garbage"])
def test_a_run_whose_metrics_are_lost_goes_on_and_says_so(damage, trained, tmp_path):
    """The rows after the checkpoint are those of the run left alone."""
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    for name in ("metrics.csv", "timing.csv"):
        (folder / name).unlink()
        if damage == "garbage":
            (folder / name).write_bytes(bytes(range(256)))
    done = run("train", f"resume={folder}", "total_frames=96", "showcase=null")
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if "has lost" in line]
    assert len(lines) == 2
    assert f"{folder}/metrics.csv has lost 2 of 2 rows" in lines[0]
    assert pd.read_csv(folder / "metrics.csv")["update"].tolist() == [3]
    again = run("train", *TINY, f"hydra.run.dir={folder}")  # it still is a run's folder
    assert "must be a folder without a run" in again.stderr


def test_a_run_from_before_worlds_had_streams_goes_on_and_says_so(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    last = folder / "checkpoints" / "last.pt"
    state = checkpoint.load(last, checkpoint.TRAINING)
    for world in state["worlds"]:
        del world["env"]["base_env"]["streams"]
        world["env"]["base_env"]["rng"] = torch.Generator().get_state()
    checkpoint.save(last, state)
    done = run("train", f"resume={folder}", "total_frames=96", "showcase=null")
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "begin anew" in line]
    assert "random numbers" in line
    assert pd.read_csv(folder / "metrics.csv")["update"].tolist() == [1, 2, 3]
    again = run("train", f"resume={folder}", "total_frames=128", "showcase=null")
    assert again.returncode == 0, again.stderr
    assert "begin anew" not in again.stdout


def test_a_checkpoint_is_there_after_the_first_update(compose_config, tmp_path):
    learner = Learner(compose_config(*TINY, "total_frames=128", "checkpoint_every=1000"))
    learn, there = learner.learn, []

    def watched(batch):
        there.append((tmp_path / "checkpoints" / "last.pt").exists())
        return learn(batch)

    learner.learn = watched
    train(learner, RunFolder(tmp_path, learner.cfg), Console(quiet=True))
    assert there == [False, True, True, True]


HOLDER = """
import sys, time
from pathlib import Path
from zfall.training.run_folder import owned
with owned(Path(sys.argv[1])):
    print("in", flush=True)
    time.sleep(60)
"""


@pytest.mark.long
def test_one_process_trains_in_a_folder_and_a_killed_one_leaves_it_free(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, folder], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        assert holder.stdout.readline() == "in\n"
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for arguments in (
            [f"resume={folder}", "total_frames=96"],
            [*TINY, f"hydra.run.dir={folder}"],
        ):
            done = run("train", *arguments)
            assert done.returncode == 1
            assert f"another trains in {folder}" in done.stderr
            assert len(done.stderr.splitlines()) == 1
        assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    finally:
        holder.kill()
        holder.wait()
    done = run("train", f"resume={folder}", "total_frames=96", "showcase=null")
    assert done.returncode == 0, done.stderr
    assert not (folder / LOCK).exists()
    assert pd.read_csv(folder / "metrics.csv")["update"].tolist() == [1, 2, 3]


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_is_said_with_what_is_left(trained, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(trained, folder)
    monkeypatch.setattr(run_folder, "append_row", full)
    done = run("train", f"resume={folder}", "total_frames=96", "showcase=null", "logger=null")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"the disk of {folder} must have room, got [Errno 28] No space left" in line
    assert f"go on with resume={folder}" in line
    checkpoint.load(folder / "checkpoints" / "last.pt")


def test_a_loggers_thread_that_finds_no_room_prints_no_traceback(monkeypatch):
    """It raises in the logger's next call; other errors of threads are shown."""
    shown = []
    monkeypatch.setattr(threading, "excepthook", lambda failed: shown.append(failed.exc_type))
    with quiet_threads():
        for work in (full, lambda: 1 / 0):
            thread = threading.Thread(target=work)
            thread.start()
            thread.join()
    assert shown == [ZeroDivisionError]


def test_a_folder_with_a_run_of_another_config_does_not_go_on(compose_config, tmp_path):
    """Whoever changes a weight and calls it again gets no mixture of both; a longer run goes on."""
    quiet = Console(quiet=True)
    run_training(compose_config(*TINY), tmp_path, quiet)
    with pytest.raises(ValueError, match=r"loss.gamma \(0.98 stored, 0.5 wanted\) must be that of"):
        run_training(compose_config(*TINY, "loss.gamma=0.5"), tmp_path, quiet)
    other = ["logger=null", "checkpoint_every=2", "name=other", "trust=[tests.training.makers]"]
    longer = [each.replace("total_frames=64", "total_frames=96") for each in TINY]
    assert run_training(compose_config(*longer, *other), tmp_path, quiet)
    assert checkpoint.load(tmp_path / "checkpoints" / "last.pt")["frames"] == 96
