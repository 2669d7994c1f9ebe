"""Which policies and baselines are tested, and in which world."""

import json
import os

import pandas as pd
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDict
from torch.testing import assert_close

from tests.shell import SMALL, TINY, run
from zfall import checkpoint
from zfall.envs.make import left_out
from zfall.envs.tables import check_same_interface, keep
from zfall.evaluation.battery import run_battery
from zfall.evaluation.candidate import SCRIPTED, held, scripted
from zfall.evaluation.definitions import load_battery
from zfall.falling.kneel_reference import KneelReference
from zfall.robots import ZEROTH01


def test_checkpoint_of_another_robot_is_refused(trained, tmp_path):
    content = checkpoint.load(trained / "checkpoints" / "last.pt")
    content.pop("format")
    (tmp_path / "checkpoints").mkdir()
    checkpoint.save(tmp_path / "checkpoints" / "last.pt", content | {"robot": "other"})
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert "must be of the robot zeroth01 " in done.stderr
    assert "it is of other" in done.stderr


def test_run_without_a_checkpoint_is_refused(tmp_path):
    done = run("evaluate", f"run={tmp_path}")
    assert done.returncode != 0
    assert f"run must be a run folder, {tmp_path} has no checkpoints." in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_newest_run_in_a_folder_of_runs_is_named(tmp_path):
    for name, time in (("a/older", 2), ("b/newest", 3), ("c", 1)):
        (tmp_path / name / "checkpoints").mkdir(parents=True)
        os.utime(tmp_path / name / "checkpoints", (time, time))
    for recipe, key in (("evaluate", "run"), ("train", "resume")):
        done = run(recipe, f"{key}={tmp_path}", f"hydra.run.dir={tmp_path}/out")
        assert f"{key} must be a run folder, {tmp_path} has no checkpoints;" in done.stderr
        assert done.stderr.endswith(f"the newest run in it is {tmp_path}/b/newest.\n")


def test_a_refused_evaluation_leaves_nothing(trained, tmp_path):
    before = sorted(trained.rglob("*"))
    done = run("evaluate", f"runs=[{trained},nowhere]", f"hydra.run.dir={tmp_path}/out")
    assert "there is no folder nowhere" in done.stderr
    done = run("evaluate", f"run={trained}", *SMALL, "trial=0", "joint=nose")
    assert "joint must be one of" in done.stderr
    assert sorted(trained.rglob("*")) == before
    assert not (tmp_path / "out").exists()


def test_an_evaluation_keeps_on_what_it_is_told_to(compose_config):
    cfg = compose_config("num_envs=2").env
    assert {"noise", "delay"} <= set(left_out(cfg.training_only))
    assert {"noise", "delay"}.isdisjoint(left_out(keep(cfg, ["noise", "delay"]).training_only))
    with pytest.raises(ValueError, match=r"keep must name what evaluation leaves out .*got action"):
        keep(cfg, ["action"])


def test_values_of_the_env_can_be_changed_and_must_be_there(trained):
    done = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.scale=0.3"]')
    assert done.returncode == 0, done.stderr
    bad = run("evaluate", f"run={trained}", *SMALL, 'change=["transforms.action.skale=0.3"]')
    assert "change must name a value of the env, there is no transforms.action.skale" in bad.stderr


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
    catch = run("evaluate", "run=scripted_catch", *own, "end_time=1.5")
    assert catch.returncode == 0, catch.stderr
    assert not pd.read_csv(path).equals(script)  # other postures
    null = 'change=["transforms.kneel_reference=null"]'
    assert run("evaluate", "run=scripted_kneel", *own, null).returncode != 0
    bad = run("evaluate", "run=scripted_kneel", *own, "env=push_recovery")
    assert "scripted_kneel needs an env with modes" in bad.stderr


def test_a_scripted_kneel_goes_to_the_kneel_however_fast_the_fall(compose_config):
    """In mode KNEEL, moving at 2 m/s; ``scripted_catch`` goes somewhere else."""
    cfg = compose_config("env=push_to_kneel", "num_envs=1").env
    reached = {}
    for name in SCRIPTED:
        transforms = instantiate(scripted(cfg, name)).transform
        reference = next(t for t in transforms if isinstance(t, KneelReference))
        for _ in range(20):
            td = TensorDict(
                {
                    "mode": torch.tensor([[0.0, 1.0, 0.0]]),
                    "base_orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
                    "com_velocity": torch.tensor([[2.0, 0.0, 0.0]]),
                    "target": reference.stand[None],
                },
                [1],
            )
            reached[name] = reference.inv(td)["target"][0]
    kneel = torch.tensor(ZEROTH01.kneel_position)
    assert_close(reached["scripted_kneel"], kneel.clamp(*reference.range.unbind(-1)))
    assert (reached["scripted_catch"] - kneel).abs().max() > 0.3


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
    times = {"push_time": 0.2, "end_time": 1.0}
    battery = load_battery("planar", impulses=[1.0], starts=1, directions=2, **times)

    def moved(world):
        targets = []
        run_battery(
            battery, world, None, watch=lambda env, td: targets.append(td["target"].clone())
        )
        return (torch.stack(targets) - torch.tensor(ZEROTH01.stand_position)).abs().max()

    assert moved(held(cfg)) < 1e-6
    assert moved(cfg) > 0.5


@pytest.mark.parametrize("name", ["start", "push"])
def test_starts_and_pushes_of_training_cannot_be_kept_in_a_battery(name):
    done = run("evaluate", "run=best", f"keep=[{name}]")
    assert done.returncode != 0
    assert f"keep must not name {name}: a battery has its own starts and pushes" in done.stderr


@pytest.mark.parametrize(
    ("one", "other", "message"),
    [
        ({"scale": 0.6, "keys": ["a"]}, {"scale": 0.6, "keys": ["b"]}, r"action.keys, got \['a'\] and \['b'\]"),
        ({"scale": 0.6}, {"scale": 0.6, "limit": None}, "action.limit, got nothing and None"),
        ({"in": {"low": 1, "high": 2}}, {"in": {"low": 1, "high": 3}}, "action.in.high, got 2 and 3"),
    ],
)  # fmt: skip
def test_what_differs_between_two_policies_is_named(one, other, message):
    base = {"base_env": {"control_dt": 0.04}}
    configs = {
        name: OmegaConf.create({"env": base | {"transforms": {"action": value, "observation": {}}}})
        for name, value in (("A", one), ("B", other))
    }
    with pytest.raises(ValueError, match=f"A and B must have the same env.transforms.{message}"):
        check_same_interface(configs)
