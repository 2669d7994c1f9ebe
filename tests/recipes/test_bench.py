"""The speed recipe."""

import json
from functools import partial

import pytest

from recipes import bench
from tests.shell import run
from zfall.training import speed

TINY = ["num_envs=8", "rollout_steps=4", "seconds=0.1"]


@pytest.mark.long
def test_bench_writes_flat_figures_and_prints_them(tmp_path, monkeypatch):
    monkeypatch.setattr(speed, "ROUNDS", 1)
    monkeypatch.setattr(speed, "loss_shares", partial(speed.loss_shares, rounds=1))
    done = run("bench", *TINY, "peers=false", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "bench.json").read_text())
    assert {"limit", "env", "env_efficiency", "train_mlp_efficiency"} <= figures.keys()
    costs = {f"loss/{loss}_{actor}" for loss in ("caps", "symmetry") for actor in ("mlp", "gru")}
    assert costs <= figures.keys()  # so short a measurement may find one below 0
    assert all(isinstance(value, float) for value in figures.values())
    assert all(value >= 0 for key, value in figures.items() if key not in costs)
    assert figures["env_efficiency"] == pytest.approx(figures["env"] / figures["limit"])
    shares = [value for key, value in figures.items() if key.startswith("transform/")]
    assert 0 < sum(shares) < 1
    assert "env_efficiency" in done.stdout


def test_an_experiment_is_measured_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(speed, "ROUNDS", 1)
    # In two groups, as more worlds are.
    monkeypatch.setattr("zfall.training.collection.PAYS_FROM", 8)
    done = run("bench", *TINY, "only=quickstart", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "bench.json").read_text())
    speeds = {key for key in figures if not key.startswith("transform/")}
    efficiencies = {f"{key}_efficiency" for key in ("env", "env_undivided", "train")}
    named = {"limit", "limit_together", "physics", "env", "env_undivided", "train"}
    assert speeds == named | efficiencies | {"env_of_physics"}
    assert all(figures[key] > 0 for key in speeds)
    assert figures["train_efficiency"] == pytest.approx(figures["train"] / figures["limit"])
    assert figures["env_of_physics"] == pytest.approx(figures["env"] / figures["physics"])


@pytest.mark.slow
def test_bench_measures_the_peers_too(tmp_path):
    done = run("bench", *TINY, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "bench.json").read_text())
    names = ("parallel_env_dm_control", "torchrl_mujoco_env", "gymnasium_async")
    assert all(figures[f"peer/{name}"] > 0 for name in names)
    # State and sensors of ten physics steps in float64, some hundred numbers each, and copies.
    assert 20 < figures["memory_per_world"] < 2000


def test_without_its_folder_peers_are_left_out_with_a_line(tmp_path, monkeypatch):
    """As in an installed wheel, which has no benchmarks/."""
    monkeypatch.setattr(bench, "config_folder", lambda: tmp_path / "recipes")
    monkeypatch.setattr(bench, "measure", lambda cfg, report: {"peers": float(cfg.peers)})
    done = run("bench", *TINY, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert "peers are left out" in done.stdout
    assert json.loads((tmp_path / "bench.json").read_text()) == {"peers": 0.0}
