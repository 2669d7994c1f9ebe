"""Policies by name and from run folders."""

import shutil

import pytest
import torch
from rich.console import Console

import zfall
from zfall.policies.load import shipped
from zfall.training import Learner, run_training

SIZES = {"num_envs": 8, "rollout_steps": 4, "minibatches": 2, "total_frames": 64, "logger": []}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of two updates, from a plain dict."""
    folder = tmp_path_factory.mktemp("run")
    assert run_training(Learner(SIZES).cfg, folder, Console(quiet=True))
    return folder


def test_a_run_folder_gives_its_policy_its_task_and_no_card(folder):
    policy = zfall.load_policy(folder)
    assert policy.config.num_envs == 8
    assert policy.card == ""
    env = policy.env(num_envs=3)
    with torch.no_grad():
        assert env.rollout(2, policy.actor)["action"].shape == (3, 2, 20)
    assert not any("push" in str(key) for key in env.observation_spec.keys(True))
    pushed = policy.env(num_envs=3, training=True)
    assert len(pushed.transform) > len(env.transform)


def test_hidden_states_are_carried_by_the_env():
    policy = zfall.load_policy("best_gru")
    with torch.no_grad():
        rollout = policy.env(num_envs=2).rollout(3, policy.actor)
    memory = rollout["recurrent_state_actor"]
    assert not memory[:, 0].any()
    assert memory[:, 2].any()


def test_a_value_of_the_env_can_be_replaced(folder):
    policy = zfall.load_policy(folder, changes=["transforms.action.scale=0.3"])
    assert policy.config.env.transforms.action.scale == 0.3
    with pytest.raises(ValueError, match=r"change must .*transforms\.nothing"):
        zfall.load_policy(folder, changes=["transforms.nothing=1"])


def test_what_a_stage_came_to_is_a_checkpoint_like_others(folder, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(folder, run)
    (run / "checkpoints" / "last.pt").rename(run / "checkpoints" / "early.pt")
    (run / "checkpoints" / "last.pt").write_bytes(b"")
    early, whole = zfall.load_policy(run, checkpoint="early"), zfall.load_policy(folder)
    states = (policy.actor.state_dict() for policy in (early, whole))
    assert all(map(torch.equal, *(state.values() for state in states)))
    wrong = {
        "late": "must be last or best or early of .*run, got late",
        "../run/early": r"got \.\./run",
    }
    for name, rule in wrong.items():
        with pytest.raises(ValueError, match=rule):
            zfall.load_policy(run, checkpoint=name)


@pytest.mark.parametrize("link", ["play.json", "evaluation", "checkpoints/last.tmp"])
def test_a_run_folder_that_leads_to_files_elsewhere_is_refused(tmp_path, link):
    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    (run / "checkpoints" / "last.pt").write_bytes(shipped("best").read_bytes())
    (run / "newest.pt").symlink_to("checkpoints/last.pt")  # within the folder
    zfall.load_policy(run)
    (tmp_path / "mine").write_text("mine")
    (run / link).symlink_to(tmp_path / "mine")
    with pytest.raises(ValueError, match=f"must be a run folder of plain files, .*{link}"):
        zfall.load_policy(run)


def test_what_is_no_policy_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"run must .*best, best_gru.*nosuch"):
        zfall.load_policy("nosuch")
    with pytest.raises(ValueError, match=f"run must .*{tmp_path}"):
        zfall.load_policy(tmp_path)
