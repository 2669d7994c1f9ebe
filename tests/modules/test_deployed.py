"""What is exported acts as what was trained, also through onnxruntime."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from recipes.export import export
from tests.shell import run
from zfall.modules.actors import gru_actor, mlp_actor
from zfall.modules.deployed import deployed, zero_memory

SPEC = Composite(observation=Unbounded((1, 12)), shape=(1,))
ACTION = Unbounded((1, 5))
ROOT = Path(__file__).parents[2]
KINDS = {
    "gaussian": lambda: mlp_actor(SPEC, ACTION, num_cells=[16]),
    "state_std": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], state_std=True),
    "mixture_mean": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], components=3, statistic="mean"),
    "shared_mode": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], components=3, shared_components=True, statistic="mode"),
    "gru_mode": lambda: gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, statistic="mode"),
    "gru_residual": lambda: gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, residual=True),
}  # fmt: skip


@pytest.mark.parametrize("kind", list(KINDS))
def test_onnx_acts_as_the_actor_over_ten_seconds(kind, tmp_path):
    """250 steps in which each feeds on its own memory; observations beyond the normaliser's clip."""
    onnxruntime = pytest.importorskip("onnxruntime")
    torch.manual_seed(0)
    actor = KINDS[kind]()
    for parameter in actor.parameters():  # far from the start, where all means are zero
        parameter.data += 0.1 * torch.randn_like(parameter)
    for module in actor.modules():
        if hasattr(module, "variance"):
            module.update(3.0 * torch.randn(500, 12) + 1.0)
    export(actor, tmp_path / "policy.onnx", size=12)
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    memory = zero_memory(actor)
    own = None if memory is None else memory.numpy()
    td = TensorDict({"is_init": torch.ones(1, 1, dtype=torch.bool)}, batch_size=[1])
    if memory is not None:
        td["recurrent_state_actor"] = memory
    worst = 0.0
    for _ in range(250):
        td["observation"] = 10.0 * torch.randn(1, 12)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            out = actor(td.clone())
        inputs = {"observation": td["observation"].numpy()}
        inputs |= {} if own is None else {"memory": own}
        action, *rest = session.run(None, inputs)
        worst = max(worst, float(np.abs(action - out["action"].numpy()).max()))
        if rest:
            own, td["recurrent_state_actor"] = rest[0], out["next", "recurrent_state_actor"]
        td["is_init"] = torch.zeros(1, 1, dtype=torch.bool)
    assert worst < 1e-5
    assert out["action"].abs().max() > 0.05
    names = [value.name for value in session.get_inputs()]
    assert names == (["observation"] if own is None else ["observation", "memory"])


def test_plain_modules_need_no_tensordict():
    actor = KINDS["gru_mode"]()
    action, memory = deployed(actor)(torch.zeros(1, 12), zero_memory(actor))
    assert action.shape == (1, 5)
    assert memory.shape == (1, 2, 8)


def test_a_run_is_exported_with_what_its_numbers_mean(tmp_path):
    pytest.importorskip("onnxruntime")
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    assert run("train", *tiny, f"hydra.run.dir={tmp_path}/run").returncode == 0
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    about = json.loads((tmp_path / "run" / "export" / "policy.json").read_text())
    assert about["control_dt_s"] == 0.04
    assert len(about["joints"]) == len(about["reference_rad"]) == 20
    assert about["observation"][0] == {
        "name": "projected_gravity",
        "from": 0,
        "to": 3,
        "unit": "1, base axes",
    }
    assert about["observation"][-1]["to"] == about["observation_size"]


@pytest.mark.parametrize(("name", "newtons"), [("best", 20), ("best_gru", 20), ("zeroth_fall", 10)])
def test_the_script_drives_the_robot_through_its_push(name, newtons, tmp_path):
    """Pushed after 3 s a policy that ships still stands after 10 s, by MuJoCo alone."""
    pytest.importorskip("onnxruntime")
    done = run("export", f"run={name}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    files = [f"{tmp_path}/policy.onnx", f"{tmp_path}/policy.json"]
    command = [sys.executable, "docs/drive.py", *files, str(newtons)]
    drive = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    height = float(drive.stdout.split(" m above")[0].split()[-1])
    assert height > 0.3  # standing it is 0.33 m


def test_what_is_observed_through_an_estimator_is_not_exported_as_the_true_quantity(tmp_path):
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    speed = "{_target_: zfall.envs.transforms.estimation.NumericalVelocity, before: observation}"
    run("train", *tiny, f"+env.transforms.speed={speed}", "env.transforms.noise=null",
        "~env.training_only.noise", f"hydra.run.dir={tmp_path}/run")  # fmt: skip
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert "must observe true quantities to be exported, got NumericalVelocity" in done.stderr


def test_what_a_transform_counts_is_not_exported(tmp_path):
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    air = "{_target_: zfall.envs.transforms.windows.FeetAirTime, before: observation}"
    keys = "env.transforms.observation.keys=[joint_position,feet_air_time]"
    trained = run(
        "train", *tiny, f"+env.transforms.air={air}", keys, f"hydra.run.dir={tmp_path}/run"
    )
    assert trained.returncode == 0, trained.stderr
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert "must observe what a robot can know to be exported, got feet_air_time" in done.stderr
    assert not (tmp_path / "run" / "export").exists()


def test_the_script_knows_the_last_action_and_every_sensor(tmp_path):
    """Feet that have several sensors, and what the policy did before."""
    pytest.importorskip("onnxruntime")
    tiny = ["num_envs=4", "rollout_steps=2", "minibatches=1", "total_frames=8", "showcase=null"]
    keys = (
        "env.transforms.observation.keys=[joint_position,feet_position,feet_velocity,last_action]"
    )
    assert run("train", *tiny, keys, f"hydra.run.dir={tmp_path}/run").returncode == 0
    done = run("export", f"run={tmp_path}/run", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    command = [sys.executable, "docs/drive.py"]
    files = [f"{tmp_path}/run/export/policy.{ending}" for ending in ("onnx", "json")]
    drive = subprocess.run([*command, *files, "0"], cwd=ROOT, capture_output=True, text=True)
    assert drive.returncode == 0, drive.stderr
    bare = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert bare.stderr.startswith("usage: docs/drive.py policy.onnx policy.json")


def test_a_baseline_cannot_be_exported(tmp_path):
    done = run("export", "run=pose_hold", f"hydra.run.dir={tmp_path}")
    assert "run must hold a policy, pose_hold is a baseline" in done.stderr
