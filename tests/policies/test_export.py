"""What is exported acts as what was trained, also through onnxruntime."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from tests.recurrent import lstm_actor, two_grus_actor
from zfall.evaluation.battery import battery_env
from zfall.evaluation.definitions import load_battery
from zfall.modules.actors import gru_actor, mlp_actor, recurrent_keys
from zfall.modules.deployed import deployed, memories_at_start
from zfall.policies.export import describe, export
from zfall.policies.on_robot import RobotPolicy

SPEC = Composite(observation=Unbounded((1, 12)), shape=(1,))
ACTION = Unbounded((1, 5))
KINDS = {
    "gaussian": lambda: mlp_actor(SPEC, ACTION, num_cells=[16]),
    "state_std": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], state_std=True),
    "mixture_mean": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], components=3, statistic="mean"),
    "shared_mode": lambda: mlp_actor(SPEC, ACTION, num_cells=[16], components=3, shared_components=True, statistic="mode"),
    "gru_mode": lambda: gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, statistic="mode"),
    "lstm": lambda: lstm_actor(SPEC, ACTION, num_layers=2),
    "two_grus": lambda: two_grus_actor(SPEC, ACTION),
    "gru_encoder": lambda: gru_actor(SPEC, ACTION, hidden_size=8, num_layers=1, encoder_cells=[6], num_cells=[7]),
    "gru_residual": lambda: gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, residual=True),
}  # fmt: skip


SLOW = {
    "shared_mode",
    "gru_encoder",
    "gru_residual",
    "gru_mode",
    "two_grus",
}  # to export; others of their kind are not


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=pytest.mark.slow) if kind in SLOW else kind for kind in KINDS],
)
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
    starts = memories_at_start(actor)
    inputs = {"observation": torch.zeros(1, 12), **starts}
    outputs = ["action", *(f"next_{name}" for name in starts)]
    export(deployed(actor), tmp_path / "policy.onnx", inputs=inputs, outputs=outputs)
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    own = {name: start.numpy() for name, start in starts.items()}
    td = TensorDict({"is_init": torch.ones(1, 1, dtype=torch.bool)}, batch_size=[1])
    td.update(dict(zip(recurrent_keys(actor), starts.values(), strict=True)))
    worst = 0.0
    for _ in range(250):
        td["observation"] = 10.0 * torch.randn(1, 12)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            out = actor(td.clone())
        action, *after = session.run(None, {"observation": td["observation"].numpy(), **own})
        worst = max(worst, float(np.abs(action - out["action"].numpy()).max()))
        own = dict(zip(own, after, strict=True))
        td.update({key: out["next", key] for key in recurrent_keys(actor)})
        td["is_init"] = torch.zeros(1, 1, dtype=torch.bool)
    assert worst < 1e-5
    assert out["action"].abs().max() > 0.05
    names = [value.name for value in session.get_inputs()]
    assert names == ["observation", *own]
    assert ("memory" in own) is kind.startswith("gru")


def test_units_are_declared_where_a_quantity_is_written(compose_config):
    """By the table of the base env, and by the transforms that a robot has as well."""
    keys = ["joint_velocity", "target", "last_action", "command", "imu_orientation"]
    added = [
        f"env.transforms.observation.keys=[{','.join(keys)}]",
        "+env.transforms.command={_target_: zfall.envs.transforms.commands.Command, before: observation}",
        "+env.transforms.imu={_target_: zfall.envs.transforms.observations.ImuOrientation, before: observation}",
    ]
    cfg = compose_config("num_envs=1", *added).env
    env, _, _ = battery_env(load_battery("planar"), cfg, 1)
    actor = mlp_actor(env.observation_spec, env.action_spec, num_cells=[4])
    about = describe(env, RobotPolicy(env, actor), cfg)
    units = {entry["name"]: entry["unit"] for entry in about["observation"]}
    assert units == {
        "joint_velocity": "rad/s",
        "target": "rad",
        "last_action": "1",
        "command": "m/s, m/s, rad, m, rad, rad",
        "imu_orientation": "1, w x y z, w >= 0",
    }
