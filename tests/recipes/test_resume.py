"""Going on with a run: the same as one not stopped, and nothing lost when it is refused."""

import shutil
import signal
import subprocess
import sys
import time

import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from tests.shell import ROOT, TINY, run
from zfall import checkpoint
from zfall.training.learner import Learner
from zfall.training.loop import resumed_config, train
from zfall.training.run_folder import VERSION, RunFolder

pytestmark = pytest.mark.long

EVENTFUL = ["env.transforms.push.interval=[0.0,0.1]", "env.transforms.limit.seconds=0.3"]
REALISTIC = "env=push_recovery_realistic"  # all transforms at once
RECURRENT = "actor=gru_mog critic=gru loss=icub"  # state of a critic, and of a penalty


# A predictor with a memory, and a machine that counts: some worlds begin to kneel.
KNEELING = (
    "experiment=push_to_kneel env.transforms.mode.probability=0.5 env.transforms.mode.hold=0.08 "
    "env.transforms.push.size=[1.0,2.0]"
)


@pytest.mark.parametrize(
    "part", [RECURRENT, *(pytest.param(p, marks=pytest.mark.slow) for p in (REALISTIC, KNEELING))]
)  # these two are killed in test_killed.py, too
def test_stopped_and_resumed_run_equals_the_one_not_stopped(part, tmp_path):
    """Same metrics, to the last digit; a row written after the checkpoint is dropped."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    common = [*TINY, *EVENTFUL, *part.split()]
    assert run("train", *common, "total_frames=96", f"hydra.run.dir={whole}").returncode == 0
    assert run("train", *common, "total_frames=64", f"hydra.run.dir={parts}").returncode == 0
    with (parts / "metrics.csv").open("a") as file:
        file.write("3,96,half a row")
    done = run("train", f"resume={parts}", "total_frames=96", f"hydra.run.dir={tmp_path}/x")
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


def test_resuming_with_another_actor_is_refused(trained, tmp_path):
    done = run("train", f"resume={trained}", "actor=mlp_mog", f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0
    assert "actor must not be given with resume" in done.stderr


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


def test_values_given_anew_are_read_as_hydra_reads_them(trained):
    """Without spaces, too: not as text that YAML would take apart another way."""
    state = checkpoint.load(trained / "checkpoints" / "last.pt")
    given = OmegaConf.create({"showcase": {"sizes": [0.2], "starts": 1, "video": False}})
    overrides = [f"resume={trained}", "showcase={sizes:[0.2],starts:1,video:false}"]
    cfg = resumed_config(state["config"], given, overrides, trained)
    assert cfg.showcase == given.showcase
    assert cfg.num_envs == OmegaConf.create(state["config"]).num_envs


def test_keys_that_a_run_was_written_without_have_their_defaults(trained, tmp_path):
    """As those of a run from before they were there."""
    shutil.copytree(trained, tmp_path / "old")
    last = tmp_path / "old" / "checkpoints" / "last.pt"
    content = checkpoint.load(last)
    config = OmegaConf.create(content["config"])
    for key in ("alike", "averaging", "augmentation", "auxiliary_share", "logger", "warm_start"):
        del config[key]
    checkpoint.save(last, content | {"config": OmegaConf.to_yaml(config)})
    done = run("train", f"resume={tmp_path}/old", "total_frames=96", "showcase=null")
    assert done.returncode == 0, done.stderr
    resumed = OmegaConf.create(checkpoint.load(last)["config"])
    assert (resumed.alike, resumed.auxiliary_share, resumed.augmentation) == (1, 0.125, None)


def test_a_run_that_came_to_its_end_was_not_stopped(compose_config, tmp_path, monkeypatch):
    """Ctrl-c in its last update is too late; in the one before it is not."""
    for last, ended in ((2, True), (1, False)):
        learner = Learner(compose_config(*TINY))
        learn = learner.learn

        def press(batch, learner=learner, learn=learn, last=last):
            if learner.updates + 1 == last:
                signal.raise_signal(signal.SIGINT)
            return learn(batch)

        monkeypatch.setattr(learner, "learn", press)
        assert (
            train(learner, RunFolder(tmp_path / str(last), learner.cfg), Console(quiet=True))
            == ended
        )


def test_resuming_leaves_other_folders_alone(trained, tmp_path):
    """Whatever hydra is told to be its folder: only one that it made, and that is empty, goes."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".hydra").mkdir()
    done = run("train", f"resume={trained}", "showcase=null", f"hydra.run.dir={tmp_path}")
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
    assert f"must be a run of version {VERSION} to go on with it, got None" in done.stderr
    assert (tmp_path / "metrics.csv").read_text() == "update,falls\n1,3\n"


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


def test_ctrl_c_amid_imports_says_so_in_one_line():
    command = "import recipes, signal; signal.raise_signal(signal.SIGINT)"
    done = subprocess.run([sys.executable, "-c", command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == -signal.SIGINT  # as the shell expects it
    assert done.stderr == "stopped\n"


def test_ctrl_c_while_a_training_is_built_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(Learner, "__init__", lambda *_: signal.raise_signal(signal.SIGINT))
    done = run("train", *TINY, f"hydra.run.dir={tmp_path}/run")
    assert (done.returncode, done.stderr) == (130, "stopped\n")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("presses", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_ctrl_c_amid_a_save_leaves_a_sound_checkpoint(presses, tmp_path, monkeypatch):
    """Once lets the update end; twice ends at once, with the checkpoint before."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert run("train", *TINY, "total_frames=96", f"hydra.run.dir={whole}").returncode == 0
    write, writes = checkpoint.os.replace, []

    def press(*paths):
        writes.append(paths)
        if len(writes) == 4:  # of best.pt or last.pt, after the second update
            for _ in range(presses):
                signal.raise_signal(signal.SIGINT)
        return write(*paths)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.os, "replace", press)
        done = run("train", *TINY, "total_frames=96", f"hydra.run.dir={parts}")
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert not list(parts.rglob("*.tmp"))
    assert checkpoint.load(parts / "checkpoints" / "last.pt")["updates"] == 3 - presses
    assert run("train", f"resume={parts}", f"hydra.run.dir={tmp_path}/x").returncode == 0
    assert (parts / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()


def test_auto_begins_a_run_and_goes_on_with_it_only_if_it_is_the_same(tmp_path):
    """Equal to one not stopped; rows of a run that was cut before its first checkpoint are gone."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert run("train", *TINY, "total_frames=96", f"hydra.run.dir={whole}").returncode == 0
    parts.mkdir()
    (parts / "metrics.csv").write_text("update,frames\n1,32\n")
    own = [*TINY, "resume=auto", f"hydra.run.dir={parts}"]
    for frames in (64, 96, 96):
        done = run("train", *own, f"total_frames={frames}")
        assert done.returncode == 0, done.stderr
    assert (parts / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()
    assert "auto" not in (parts / ".hydra" / "config.yaml").read_text()
    bad = run("train", *own, "total_frames=128", "loss.gamma=0.5")
    assert bad.returncode == 1
    assert "loss.gamma (0.98 stored, 0.5 wanted) must be that of the run in" in bad.stderr
